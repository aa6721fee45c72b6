#include "run/work_account.hpp"

namespace contactvi {

namespace {

// What the momentum of each follower has, from which that of its leaders is without.
VecX of_followers(const Tree& tree, const double* p) {
  VecX found(static_cast<Eigen::Index>(tree.followers.size()));
  for (std::size_t k = 0; k < tree.followers.size(); ++k) found[static_cast<Eigen::Index>(k)] = p[tree.followers[k].iv];
  return found;
}

}  // namespace

void WorkAccount::start(double t, const Tree& tree, const VecX& p, bool does_work) {
  tally_ = WorkTally();
  tally_.does_work = does_work;
  tally_.reactions.setZero(tree.elements.constraint_rows + static_cast<Eigen::Index>(tree.followers.size()));
  tally_.pending = of_followers(tree, p.data());
  tally_.mean_reactions = tally_.reactions;
  tally_.node_time = t;
}

WorkAccount::FreeWork WorkAccount::of(const Integrator& integrator) const {
  if (!tally_.does_work) return {};
  FreeWork work{integrator.input_work(), integrator.damping_loss()};
  const StageConstraints* constraints = integrator.constraints();
  if (constraints) {
    work.joint_friction = -constraints->load_work();
    work.driven = constraints->work();
  }
  if (tally_.reactions.size() == 0) return work;
  const VecX coupled = integrator.coupled_impulses();
  work.reactions.setZero(tally_.reactions.size());
  work.reactions.tail(coupled.size()) = coupled;
  if (constraints) work.reactions.head(constraints->impulses().size()) = constraints->impulses();
  return work;
}

void WorkAccount::add(const FreeWork& work) {
  tally_.input += work.input;
  tally_.damping += work.damping;
  tally_.driven += work.driven;
  tally_.joint_friction += work.joint_friction;
  add_reactions(work.reactions);
}

void WorkAccount::add(const FreeWork& work, const std::vector<int>& rows) {
  tally_.input += work.input;
  tally_.damping += work.damping;
  tally_.driven += work.driven;
  tally_.joint_friction += work.joint_friction;
  for (Eigen::Index k = 0; k < work.reactions.size(); ++k) tally_.reactions[rows[k]] += work.reactions[k];
}

void WorkAccount::add(const ContactStep& step) {
  tally_.input += step.input_work();
  tally_.damping += step.damping_loss();
  tally_.joint_friction += step.joint_friction_loss();
  tally_.driven += step.driven_work();
  if (step.constrained()) add_reactions(step.constraint_impulses());
  const VecX coupled = step.integrator().coupled_impulses();
  tally_.reactions.tail(coupled.size()) += coupled;
}

void WorkAccount::add(const DenseStep& step) {
  tally_.input += step.integrator().input_work();
  tally_.damping += step.integrator().damping_loss();
  tally_.joint_friction += step.joint_friction_loss();
  tally_.driven += step.driven_work();
  add_reactions(step.constraint_impulses());
  const VecX coupled = step.integrator().coupled_impulses();
  tally_.reactions.tail(coupled.size()) += coupled;
}

void WorkAccount::add(const ImpactSequence& impacts) {
  add_reactions(impacts.constraint_impulses());
  tally_.driven += impacts.driven_work();
}

void WorkAccount::add_reactions(const VecX& impulses) { tally_.reactions.head(impulses.size()) += impulses; }

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

void WorkAccount::record_node(double t, const Tree& tree, Recording& recording) {
  if (!tally_.does_work) return;
  recording.work.resize(4 * (recording.t.size() - 1), 0.0);  // nodes from before the first input have none
  recording.work.insert(recording.work.end(), {tally_.input, tally_.damping, tally_.joint_friction, tally_.driven});
  if (t > tally_.node_time) {
    if (!tree.followers.empty()) {
      const VecX now = of_followers(tree, recording.p.data() + recording.p.size() - tree.nv);
      tally_.reactions.tail(now.size()) += now - tally_.pending;
      tally_.pending = now;
    }
    tally_.mean_reactions = tally_.reactions / (t - tally_.node_time);
    tally_.reactions.setZero();
    tally_.node_time = t;
  }
  recording.reactions.insert(recording.reactions.end(), tally_.mean_reactions.data(),
                             tally_.mean_reactions.data() + tally_.mean_reactions.size());
}

}  // namespace contactvi
