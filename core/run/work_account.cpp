#include "run/work_account.hpp"

namespace contactvi {

void WorkAccount::start(double t, int constraint_rows, bool does_work) {
  *this = WorkAccount();
  does_work_ = does_work;
  reactions_.setZero(constraint_rows);
  mean_reactions_ = reactions_;
  node_time_ = t;
}

WorkAccount::FreeWork WorkAccount::of(const Integrator& integrator) const {
  if (!does_work_) return {};
  return {integrator.input_work(), integrator.damping_loss()};
}

void WorkAccount::add(const FreeWork& work) {
  input_ += work.input;
  damping_ += work.damping;
}

void WorkAccount::add(const ContactStep& step) {
  input_ += step.input_work();
  damping_ += step.damping_loss();
  joint_friction_ += step.joint_friction_loss();
  driven_ += step.driven_work();
  if (step.constrained()) reactions_ += step.constraint_impulses();
}

void WorkAccount::add(const DenseStep& step) {
  input_ += step.integrator().input_work();
  damping_ += step.integrator().damping_loss();
  joint_friction_ += step.joint_friction_loss();
}

void WorkAccount::add(const ImpactSequence& impacts) {
  reactions_ += impacts.constraint_impulses();
  driven_ += impacts.driven_work();
}

void WorkAccount::clear() {
  input_ = damping_ = joint_friction_ = driven_ = 0.0;
  reactions_.setZero();
}

void WorkAccount::take(WorkAccount& part, const std::vector<int>& rows) {
  if (!part.does_work_) return;
  input_ += part.input_;
  damping_ += part.damping_;
  joint_friction_ += part.joint_friction_;
  driven_ += part.driven_;
  for (std::size_t k = 0; k < rows.size(); ++k) reactions_[rows[k]] += part.reactions_[static_cast<Eigen::Index>(k)];
  part.clear();
}

void WorkAccount::record_node(double t, Recording& recording) {
  if (!does_work_) return;
  recording.work.resize(4 * (recording.t.size() - 1), 0.0);  // nodes from before the first input have none
  recording.work.insert(recording.work.end(), {input_, damping_, joint_friction_, driven_});
  if (t > node_time_) {
    mean_reactions_ = reactions_ / (t - node_time_);
    reactions_.setZero();
    node_time_ = t;
  }
  recording.reactions.insert(recording.reactions.end(), mean_reactions_.data(),
                             mean_reactions_.data() + mean_reactions_.size());
}

}  // namespace contactvi
