// Derivatives of the momenta P and the forces G by velocity and displacement, at several states at once, as matrices.
//
//   dP = M dv + B dx,  dG = C dv + K dx
//
// with displacements dx that turn the bodies of spherical joints (body frame). The kernel's dual numbers give one
// column after the other, in each lane that of another state or dof. Dofs of the same level, on different branches, act
// on no common dof that they carry, so their columns come out of one evaluation; what a dof does to those that carry it
// follows from the symmetry of second derivatives: M and K are symmetric, and B is the transpose of C.
#pragma once

#include <vector>

#include "model/dof_pattern.hpp"
#include "step/stages.hpp"

namespace contactvi {

// A matrix over the pairs of a DofPattern at each of several points, [entry * points + point].
struct PairMatrix {
  PairMatrix(const DofPattern& pattern, int points)
      : points(points), low(static_cast<std::size_t>(pattern.entries()) * points), up(low) {}
  // Row: the entry's dof, column: the one on its path; and the reverse. Diagonal entries are low.
  double* row(int entry) { return low.data() + static_cast<std::size_t>(entry) * points; }
  double* column(int entry) { return up.data() + static_cast<std::size_t>(entry) * points; }
  const double* row(int entry) const { return low.data() + static_cast<std::size_t>(entry) * points; }
  const double* column(int entry) const { return up.data() + static_cast<std::size_t>(entry) * points; }
  double* at(DofPattern::Pair pair) { return pair.low ? row(pair.entry) : column(pair.entry); }
  const double* at(DofPattern::Pair pair) const { return pair.low ? row(pair.entry) : column(pair.entry); }

  int points;
  std::vector<double> low, up;
};

class LocalTangent {
 public:
  LocalTangent(const Tree& tree, const FlatModel& model, const DofPattern& pattern, int points);
  LocalTangent(const LocalTangent&) = delete;
  LocalTangent& operator=(const LocalTangent&) = delete;

  // The points: displacements in the charts at q0 and velocities, (nv, points); fills what follows. Of the forces it
  // knows those that are linear in a joint's coordinates, as in a step of length h with the input tau and the servo.
  void evaluate(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau, const Servo* servo, const MatX& X,
                const MatX& v);

  // With a single point: of the state (q, v), without forces.
  void evaluate_at(const VecX& q, const VecX& v);

  PairMatrix M, B, C, K;
  MatX P, G;  // (nv, points)

 private:
  struct Entry {
    int dof, entry;
  };
  struct Job {  // a column to evaluate
    int point;
    bool velocity;
    int level;
  };
  void evaluate_jobs(const MatX& X, const MatX& v);
  void set_lanes(const Job* jobs, int count, const MatX& X, const MatX& v);
  void read_lane(const Job& job, int lane);
  void complete();

  const Tree* tree_;
  const DofPattern* pattern_;
  Stages stages_;
  std::vector<Job> jobs_;
  std::vector<std::vector<int>> dofs_;       // by level in the tree
  std::vector<std::vector<Entry>> carried_;  // by level of the column: rows that it carries, itself included
  std::vector<std::vector<Entry>> within_;   // rows before it in its own joint, whose entries are not symmetric
  std::vector<int> symmetric_;               // entries between different joints
};

}  // namespace contactvi
