#include "run/work_account.hpp"

namespace contactvi {

void WorkAccount::start(double t, int constraint_rows, bool does_work) {
  tally_ = WorkTally();
  tally_.does_work = does_work;
  tally_.reactions.setZero(constraint_rows);
  tally_.mean_reactions = tally_.reactions;
  tally_.node_time = t;
}

WorkAccount::FreeWork WorkAccount::of(const Integrator& integrator) {
  if (!tally_.does_work) return {};
  const StageConstraints* constraints = integrator.constraints();
  if (constraints) seen_ = constraints->impulses();
  return {integrator.input_work(), integrator.damping_loss(), constraints ? constraints->work() : 0.0};
}

void WorkAccount::add(const FreeWork& work) {
  tally_.input += work.input;
  tally_.damping += work.damping;
  tally_.driven += work.driven;
  if (seen_.size() > 0) tally_.reactions += seen_;
}

void WorkAccount::add(const ContactStep& step) {
  tally_.input += step.input_work();
  tally_.damping += step.damping_loss();
  tally_.joint_friction += step.joint_friction_loss();
  tally_.driven += step.driven_work();
  if (step.constrained()) tally_.reactions += step.constraint_impulses();
}

void WorkAccount::add(const DenseStep& step) {
  tally_.input += step.integrator().input_work();
  tally_.damping += step.integrator().damping_loss();
  tally_.joint_friction += step.joint_friction_loss();
  tally_.driven += step.driven_work();
  tally_.reactions += step.constraint_impulses();
}

void WorkAccount::add(const ImpactSequence& impacts) {
  tally_.reactions += impacts.constraint_impulses();
  tally_.driven += impacts.driven_work();
}

void WorkAccount::clear() {
  tally_.input = tally_.damping = tally_.joint_friction = tally_.driven = 0.0;
  tally_.reactions.setZero();
}

void WorkAccount::take(WorkAccount& part, const std::vector<int>& rows) {
  if (!part.tally_.does_work) return;
  tally_.input += part.tally_.input;
  tally_.damping += part.tally_.damping;
  tally_.joint_friction += part.tally_.joint_friction;
  tally_.driven += part.tally_.driven;
  for (std::size_t k = 0; k < rows.size(); ++k)
    tally_.reactions[rows[k]] += part.tally_.reactions[static_cast<Eigen::Index>(k)];
  part.clear();
}

void WorkAccount::record_node(double t, Recording& recording) {
  if (!tally_.does_work) return;
  recording.work.resize(4 * (recording.t.size() - 1), 0.0);  // nodes from before the first input have none
  recording.work.insert(recording.work.end(), {tally_.input, tally_.damping, tally_.joint_friction, tally_.driven});
  if (t > tally_.node_time) {
    tally_.mean_reactions = tally_.reactions / (t - tally_.node_time);
    tally_.reactions.setZero();
    tally_.node_time = t;
  }
  recording.reactions.insert(recording.reactions.end(), tally_.mean_reactions.data(),
                             tally_.mean_reactions.data() + tally_.mean_reactions.size());
}

}  // namespace contactvi
