// The impulses of the persistent contacts in a smooth step that holds them, one for each contact and step.
//
// A step has impulses at its nodes, which tell forces to a low order each; their sum has the order of the step.
// Contacts that share a load have the least impulses that keep their rows, which need not be ones that contacts may
// have.
#pragma once

#include "contact/persistent_rows.hpp"
#include "step/stage_constraints.hpp"

namespace contactvi {

class HeldImpulses {
 public:
  struct Impulse {
    Vec3 local = Vec3::Zero();   // (n, t1, t2) [N s]
    Vec3 world = Vec3::Zero();   // on geometry b
    Vec3 normal = Vec3::Zero();  // of it, what acts along the normals of the nodes
    double work = 0.0;           // of friction [J]
    double bound = 0.0;          // of what sticks with a coefficient that depends on its force: of its friction [N s]
    double least = 0.0;          // of what slides with such a coefficient: normal one of a node, if it pulls [N s]
  };

  // Takes those of the step, or the part of one, that was solved last.
  void take(const std::vector<PersistentContact>& contacts, const PersistentRows& rows, const StageConstraints& step);
  const Impulse& of(std::size_t i) const { return impulses_[i]; }
  // Whether all of them push and are in their cones; where friction depends on the force, those of each node push.
  bool are_admissible() const;
  // Whether the last of these is what they are not: in a step so short that forces are rounding, or after a blow.
  bool some_node_pulls() const;
  double friction_work() const;  // [J], <= 0
  // The mean normal of a contact whose normal turns in the step and is this one at its end: that of its normal
  // impulses, turned on towards all of the impulse, by an angle of second order, where this would leave its cone.
  Vec3 mean_normal(std::size_t i, const Vec3& normal) const;

 private:
  void share_friction();

  double bound(std::size_t i) const;
  double slack() const;

  const std::vector<PersistentContact>* contacts_ = nullptr;
  const PersistentRows* rows_ = nullptr;
  std::vector<Impulse> impulses_;
  double rounding_ = 0.0;  // of the sums of what acts at the nodes [N s]
};

}  // namespace contactvi
