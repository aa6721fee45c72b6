// The derivative of a recorded run along directions of its start, inputs and parameters: piece after piece, through the
// impacts between them.
//
// What is differentiated is what was computed: partial step, impact map, rest of the step. The time of an event moves
// with the direction: its gap is zero there, so that with F the partial step of length h, F_h its derivative by h and W
// the gradient of the gap
//   dT = -(W . dq) / (W . F_h),   dq the change of q at the time of the event,
// and a piece that starts at a time that moves by dT and ends at a fixed one has dh = -dT. Steps with other lengths
// than these (halved ones) count as having fixed lengths.
#pragma once

#include <optional>

#include "sensitivity/contact_pieces.hpp"
#include "sensitivity/event_hit.hpp"
#include "sensitivity/impact_tangent.hpp"
#include "sensitivity/piece_inputs.hpp"
#include "step/node_map.hpp"
#include "step/public_tangent.hpp"
#include "step/step_map.hpp"

namespace contactvi {

// How an event moves and how well it is conditioned.
struct EventReport {
  int impact;               // the first one of the event
  double time;              // [s]
  double approach, margin;  // ImpactTangent
  int guards;               // how many different ones had impacts in it
};

struct RunDerivative {
  std::vector<double> times;  // of the nodes that were asked for [s]
  std::vector<MatX> nodes;    // d(q, v) there in public coordinates, (2 nv, count)
  std::vector<EventReport> events;
  MatX event_times;                    // dT of the events, (events, count) [s]
  std::vector<DenseStepReport> dense;  // of all dense steps
  std::vector<Obstacle> kinks;         // where some direction has a kink and the branch of the run was taken
  double growth = 0;                   // largest size of the derivative of a state on the way, of its size at the start
};

class RunTangent {
 public:
  // take_branch: at kinks, the derivative of what the run did (kinks.hpp); else they are obstacles.
  RunTangent(const Scene& scene, const RecordedRun& run, bool take_branch);

  // The derivative at these times, ascending. Throws NoDerivative.
  RunDerivative solve(const RunDirections& directions, const std::vector<double>& times);

 private:
  void start(const RunDirections& directions);
  void take_piece(const Piece& piece);
  void take_step(const VecX& q, const VecX& p, double h, double time, const MatX& velocities);
  StepTangent& tangent();
  bool apply_map(const Piece& piece, const RunDirections& directions);
  void take_part(Piece& part, double length);
  void move(const Piece& piece, const RunDirections& directions);
  void solve_length(const Piece& piece);
  void take_event(const Piece& piece, const RunDirections& directions, RunDerivative& result);
  void set_reference(const Piece& piece);
  void take_impact(const RecordedImpact& impact);
  VecX time_change(const EventHit& hit, double& approach);
  void apply_impact(const RecordedImpact& impact, const RunDirections& directions);
  void reach_node(const VecX& q, const VecX& p, double time, const RunDirections& directions);
  void record(double time, const VecX& q, const VecX& p, const RunDirections& directions, RunDerivative& result);

  const Scene* scene_;
  const RecordedRun* run_;
  Kinks kinks_;
  bool forces_in_time_;
  Integrator integrator_;
  StepTangent tangent_;  // of single directions
  bool tangent_has_step_ = false;
  StepMap map_;  // of many
  NodeMap node_map_;
  std::optional<StepSolution> step_;  // that was taken
  HeldStepRecord part_record_;        // of a part of it
  MatX rest_velocities_, q1_, p1_;
  PieceInputs inputs_;
  ImpactTangent impact_;
  StepDirection direction_;
  RunColumns columns_, step_columns_;  // here, and at the start of the step
  VecX reference_, piece_energy_;      // per column: of an implicit map, and of the piece before an event
  VecX step_q_, step_p_;
  long reference_step_ = -1;
  VecX dq_, dp_, fq_, fp_;
  VecX size_q_, size_p_;  // per column: largest changes of q and p so far
  ContactPieces contact_;
};

}  // namespace contactvi
