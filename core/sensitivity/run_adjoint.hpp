// The gradient of a function of a recorded run: from its gradients in the states at the nodes to those in the start,
// the inputs of all steps and the parameters, by the transposes of the maps of RunTangent in the reverse order.
//
// A smooth piece costs one transposed step (StepAdjoint), one with persistent contacts too. The linear maps of impacts
// are made as matrices, and so is the energy by which DTEC takes its reference: events are rare beside steps.
#pragma once

#include "sensitivity/contact_piece_adjoint.hpp"
#include "sensitivity/event_hit.hpp"
#include "sensitivity/impact_tangent.hpp"
#include "sensitivity/piece_inputs.hpp"
#include "sensitivity/run_gradient.hpp"
#include "step/public_tangent.hpp"

namespace contactvi {

// Gradients of a function in the states (q, v) at nodes and in the times of events, public coordinates.
struct RunCost {
  std::vector<double> times;  // of the nodes, ascending [s]
  MatX q, v;                  // (nodes, nv)
  VecX events;                // in the times of the events with impacts, one per piece that ends at one; or empty
};

class RunAdjoint {
 public:
  RunAdjoint(const Scene& scene, const RecordedRun& run, bool take_branch);

  // steps: of the run. Throws NoDerivative; but what depends on the direction, points that are hit together or share a
  // load along some directions and not along others, is not seen here: RunTangent along a random direction sees it.
  RunGradient solve(const RunCost& cost, long steps);

 private:
  // The linear map of an impact: its rows are those of the momentum after it, and of the energy that it takes.
  struct ImpactMatrix {
    MatX q, p;                   // (nv + 1, nv)
    MatX e, mu;                  // (nv + 1, points)
    VecX reference, rest, time;  // (nv + 1,)
  };

  void add_node(const RunCost& cost, std::size_t node, const VecX& q, const VecX& p, RunGradient& result);
  void leave_node(const VecX& q, const VecX& p, double time);
  void pass_event(const Piece& piece, double time_gradient, RunGradient& result);
  void pass_impact(const RecordedImpact& impact, RunGradient& result);
  void pass_reference(std::size_t piece);
  void pass_piece(const Piece& piece, bool start_moves, RunGradient& result);
  void add_energy_gradient(const VecX& q, const VecX& p);
  void set_impact_matrix();
  void step_back(long step, RunGradient& result);

  const Scene* scene_;
  const RecordedRun* run_;
  Kinks kinks_;
  Integrator integrator_;
  StepTangent tangent_;
  StepAdjoint adjoint_;
  PieceInputs inputs_;
  ImpactTangent impact_;
  ImpactMatrix matrix_;
  ContactPieceAdjoint contact_;
  // Gradients in the state, in the time where the next piece starts, in the reference of an implicit map, and of DTEC
  // in the energy of the piece.
  VecX lq_, lp_;
  double ltime_ = 0.0, lreference_ = 0.0, lenergy_ = 0.0;
  VecX lq0_, lp0_, ltau_;
  double lh_ = 0.0;
};

}  // namespace contactvi
