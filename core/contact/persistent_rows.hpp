// Persistent contacts as the rows of smooth steps: what sticks has three, what slides or has no friction one. Joints
// with friction that stick have one.
//
// A material point sticks where its displacement on the other surface stays zero. Surfaces that roll on each other have
// no such displacement: the velocity of their slip is zero.
#pragma once

#include <vector>

#include "contact/friction_joint.hpp"
#include "contact/persistent_geometry.hpp"
#include "model/friction_state.hpp"
#include "step/phase_rows.hpp"

namespace contactvi {

class PersistentRows final : public PhaseRows {
 public:
  PersistentRows(Guards& guards, int nv) : guards_(&guards), geometry_(guards), row_of_(nv, 3), load_(VecX::Zero(nv)) {}

  // Takes the contacts as they stick and slide now; places: at which a step looks at them.
  void set(const std::vector<PersistentContact>& contacts, const std::vector<FrictionJoint>& joints, int places);

  int count() const override { return count_; }
  bool by_rate(int row) const override { return by_rate_[static_cast<std::size_t>(row)] != 0; }
  const std::vector<Slide>& slides() const override { return slides_; }
  void place(int place, const VecCRef& q, double t, Placed at) override;
  const VecX* load() const override { return loaded_ ? &load_ : nullptr; }
  double start_angle(int slide, const Eigen::Vector2d& slip, double speed) const override;

  // Of contact i: its first row, and its number among the sliding ones, -1: it does not slide.
  int row(std::size_t i) const { return rows_[i]; }
  int slide(std::size_t i) const { return slide_[i]; }
  // Of a material point: from where its displacement counts (PersistentGeometry).
  const Vec3& reference(std::size_t i) const { return references_[i]; }
  bool friction_varies(int slide) const override;
  // Of one that sticks, too.
  bool friction_by_forces() const override { return by_forces_; }
  bool set_friction(const std::vector<SlideState>& slides) const override;
  // Of contact i, which slides with this speed or sticks, at the time t [s]: its coefficient, mu where the force does
  // not press, and its derivatives.
  FrictionState friction(std::size_t i, double speed, double normal, double t, double mu, bool derivatives) const;
  bool friction_by_state(std::size_t i) const { return by_forces_ && depends_on_force(i); }
  bool any_adheres() const override { return adheres_; }
  // Row of a joint with friction, -1: it slides.
  int joint_row(std::size_t k) const { return joint_rows_[k]; }
  // Where a contact is at a place of the step: its tangents, world.
  struct Site {
    Contact contact;
    TangentFrame frame;
    double pull = 0.0;      // adhesion [N]
    Vec3 side;              // of a rim: direction from its centre to the point, world
    Eigen::Vector2d along;  // see Manifolds::place_along
  };
  // Whether a point runs so far between two nodes of the step, around a rim or along lines, that its gap between them
  // is not that of their polynomial.
  bool runs_far(int nodes) const;
  const Site& site(int place, std::size_t i) const { return sites_[static_cast<std::size_t>(place)][i]; }

 private:
  bool depends_on_force(std::size_t i) const;

  Guards* guards_;
  PersistentGeometry geometry_;
  const std::vector<PersistentContact>* contacts_ = nullptr;
  int count_ = 0;
  std::vector<int> rows_, slide_;
  std::vector<std::size_t> sliding_;  // contact of each slide
  std::vector<char> by_rate_;
  std::vector<Slide> slides_;
  std::vector<Vec3> references_;
  std::vector<std::vector<Site>> sites_;
  MatX row_of_;
  const std::vector<FrictionJoint>* joints_ = nullptr;
  std::vector<int> joint_rows_;
  bool loaded_ = false, adheres_ = false, by_forces_ = false;
  VecX load_;
};

}  // namespace contactvi
