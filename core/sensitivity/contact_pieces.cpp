#include "sensitivity/contact_pieces.hpp"
#include "sensitivity/known_laws.hpp"

#include <cmath>

namespace contactvi {

ContactPieces::ContactPieces(const Scene& scene, const RecordedRun& run, Kinks& kinks)
    : scene_(&scene),
      run_(&run),
      tangent_(scene, kinks),
      kinks_(&kinks),
      force_(scene, run),
      joint_anchors_(static_cast<Eigen::Index>(scene.tree.elements.friction_dofs.size()), 0) {}

void ContactPieces::start(Eigen::Index count) {
  anchors_.clear();
  joint_anchors_.setZero(joint_anchors_.rows(), count);
  size_q_.setZero(count);
  size_p_.setZero(count);
}

void check_contact_piece(const RecordedRun& run, const Piece& piece) {
  if (piece.contact == nullptr && piece.dense == nullptr)
    throw NoDerivative({"dense", -1, piece.t}, "A step of the run was not kept", "all steps with contacts",
                       "a dense step that is not known", "Compute the run again with record='gradient'");
  if (piece.contact != nullptr && piece.contact->contacts.empty()) return;
  const int guard = piece.contact != nullptr ? piece.contact->contacts[0].before.point.guard : -1;
  if (run.map != ImpactMap::kCtec)
    throw NoDerivative({"map", guard, piece.t}, "An implicit impact map acts in a run with persistent contacts",
                       "impact='ctec' where contacts persist", "another map", "Use impact='ctec'");
}

void refuse_sticking_start(const ContactPoint& point, double time) {
  throw NoDerivative({"start", point.guard, time}, "The run starts with a contact that sticks already",
                     "a run from a start of its own", "one that goes on from another", "Start with simulate()");
}

void ContactPieces::take(const Piece& piece, const PieceInputs& inputs) {
  if (piece.held == nullptr) check_contact_piece(*run_, piece);
  piece_ = &piece;
  step_ = piece.contact;
  dense_step_ = piece.dense;
  held_piece_ = piece.held != nullptr ? &piece : nullptr;
  inputs_ = &inputs;
  if (held_piece_ != nullptr) {
    if (!held_) held_ = std::make_unique<HeldStepTangent>(*scene_, run_->stages, run_->contact_points, *kinks_);
    for (const PersistentContact& c : piece.held->contacts)
      if (c.anchored && anchor_of(c.point) == nullptr) refuse_sticking_start(c.point, piece.t);
    held_->take(*piece.held, inputs.tau(), inputs.servo());
    force_ends_ = ends_by_force(piece, *held_, inputs, force_);
    return;
  }
  if (dense_step_ != nullptr) {
    if (!dense_) dense_ = std::make_unique<DenseStepTangent>(*scene_, *kinks_);
    dense_->take(*dense_step_, inputs.tau(), inputs.servo());
    return;
  }
  for (const ContactStepRecord::Contact& c : step_->contacts)
    if (c.before.anchored && anchor_of(c.before.point) == nullptr) refuse_sticking_start(c.before.point, piece.t);
  tangent_.take(*step_, inputs.tau(), inputs.servo());
}

void ContactPieces::solve_length(VecRef fq, VecRef fp) {
  direction_ = ContactStepDirection();
  direction_.h = 1.0;
  if (held_piece_ != nullptr) return held_->solve(direction_, fq, fp);
  tangent_.solve(direction_, fq, fp);
}

double ContactPieces::energy_change() { return tangent_.energy_change_before(); }

const ContactPieces::Anchor* ContactPieces::anchor_of(const ContactPoint& point) const {
  for (const Anchor& a : anchors_)
    if (same_point(a.point, point)) return &a;
  return nullptr;
}

void ContactPieces::move(const RunDirections& d, RunColumns& columns) {
  if (dense_step_ != nullptr) {
    move_dense(d, columns);
    return;
  }
  if (held_piece_ != nullptr) return move_held(d, columns);
  const bool ends_itself = has_own_end(*step_, tangent_, *inputs_, force_, *kinks_);
  const double share = step_->ending == ContactStepEnd::kLength ? step_->share : 0.0;
  const auto contacts = static_cast<Eigen::Index>(step_->contacts.size());
  slip_.setZero(d.count);
  energies_.setZero(d.count);
  const bool energies = run_->map == ImpactMap::kDtec && step_->ending == ContactStepEnd::kImpact;
  size_q_ = size_q_.cwiseMax(columns.q.cwiseAbs().colwise().maxCoeff().transpose());
  size_p_ = size_p_.cwiseMax(columns.p.cwiseAbs().colwise().maxCoeff().transpose());
  for (Eigen::Index k = 0; k < d.count; ++k) {
    direction_.q = columns.q.col(k);
    direction_.p = columns.p.col(k);
    direction_.tau = d.tau.size() > 0 ? VecX(d.tau.col(k)) : VecX();
    direction_.t = columns.time[k];
    direction_.h = -columns.time[k] * (ends_itself ? 1.0 : share);
    direction_.joints = joint_anchors_.col(k);
    direction_.size_q = size_q_[k];
    direction_.size_p = size_p_[k];
    direction_.mu = friction_change(d, k);
    direction_.parameters = d.parameter(k);
    direction_.anchors.setZero(3, contacts);
    for (Eigen::Index i = 0; i < contacts; ++i) {
      const PersistentContact& before = step_->contacts[i].before;
      if (before.anchored) direction_.anchors.col(i) = anchor_of(before.point)->change.col(k);
    }
    tangent_.solve(direction_, columns.q.col(k), columns.p.col(k));
    slip_[k] = tangent_.slip_change();
    if (energies) energies_[k] = tangent_.energy_change_before();
    if (!ends_itself) columns.time[k] += direction_.h;
  }
  if (!ends_itself || step_->ending == ContactStepEnd::kImpact) return;
  end(step_->ending == ContactStepEnd::kRelease, d, columns);
}

void ContactPieces::move_dense(const RunDirections& d, RunColumns& columns) {
  const auto contacts = static_cast<Eigen::Index>(dense_step_->contacts.size());
  size_q_ = size_q_.cwiseMax(columns.q.cwiseAbs().colwise().maxCoeff().transpose());
  size_p_ = size_p_.cwiseMax(columns.p.cwiseAbs().colwise().maxCoeff().transpose());
  DenseStepDirection direction;
  for (Eigen::Index k = 0; k < d.count; ++k) {
    direction.q = columns.q.col(k);
    direction.p = columns.p.col(k);
    direction.tau = d.tau.size() > 0 ? VecX(d.tau.col(k)) : VecX();
    direction.t = columns.time[k];
    direction.h = -columns.time[k] * dense_step_->share;
    direction.size_q = size_q_[k];
    direction.size_p = size_p_[k];
    direction.mu.setZero(contacts);
    direction.e.setZero(contacts);
    for (Eigen::Index i = 0; i < contacts; ++i) {
      const DenseStepRecord::Contact& c = dense_step_->contacts[i];
      if (d.mu.size() > 0 && c.mu > 0.0) direction.mu[i] = d.mu(c.point.guard, k);
      if (d.e.size() > 0) direction.e[i] = d.e(c.point.guard, k);
    }
    direction.parameters = d.parameter(k);
    dense_->solve(direction, columns.q.col(k), columns.p.col(k));
    columns.time[k] += direction.h;
  }
}

// As a smooth step without rows: to the time that it ends at or, where it has a given length, so long after its start.
void ContactPieces::move_held(const RunDirections& d, RunColumns& columns) {
  energies_.setZero(d.count);
  slip_.setZero(d.count);
  std::vector<VecX> slips, sizes;
  size_q_ = size_q_.cwiseMax(columns.q.cwiseAbs().colwise().maxCoeff().transpose());
  size_p_ = size_p_.cwiseMax(columns.p.cwiseAbs().colwise().maxCoeff().transpose());
  held_anchors_ = held_anchors(columns);
  for (Eigen::Index k = 0; k < d.count; ++k) {
    ContactStepDirection direction;
    direction.anchors.setZero(3, static_cast<Eigen::Index>(held_piece_->held->contacts.size()));
    for (std::size_t i = 0; i < held_piece_->held->contacts.size(); ++i) {
      const PersistentContact& c = held_piece_->held->contacts[i];
      if (c.anchored) direction.anchors.col(static_cast<Eigen::Index>(i)) = anchor_of(c.point)->change.col(k);
    }
    direction.size_q = size_q_[k];
    direction.size_p = size_p_[k];
    direction.q = columns.q.col(k);
    direction.p = columns.p.col(k);
    direction.tau = d.tau.size() > 0 ? VecX(d.tau.col(k)) : VecX();
    inputs_->mask(direction.tau);
    direction.t = columns.time[k];
    direction.h = held_piece_->end == PieceEnd::kLength && !force_ends_ ? 0.0 : -columns.time[k];
    direction.mu = friction_change(d, k);
    direction.parameters = d.parameter(k);
    held_->solve(direction, columns.q.col(k), columns.p.col(k));
    slips.push_back(held_->slip_changes());
    sizes.push_back(held_->slip_sizes());
    if (held_piece_->end == PieceEnd::kTime) columns.time[k] = 0.0;
  }
  if (held_piece_->ends_itself()) check_rests(slips, sizes);
  if (held_piece_->ends_itself() || force_ends_) end(force_ends_, d, columns);
}

// Slips that come to rest at one instant do so along every direction, or there is a kink. Of each column: the changes
// of these slips, and the sizes of their terms.
void ContactPieces::check_rests(const std::vector<VecX>& slips, const std::vector<VecX>& sizes) {
  VecX fq(held_piece_->p.size()), fp(held_piece_->p.size());
  solve_length(fq, fp);
  const VecX rates = held_->slip_changes();
  for (std::size_t k = 0; k < slips.size(); ++k) {
    const auto column = static_cast<Eigen::Index>(k);
    slip_[column] = slips[k][0];
    if (rates[0] == 0.0) continue;
    const VecX with_first = rates * (slips[k][0] / rates[0]), size = sizes[k] + slips[k].cwiseAbs();
    if (((slips[k] - with_first).array().abs() <= kTogether * size.array()).all()) continue;
    kinks_->meet(NoDerivative({"stick", -1, held_piece_->t + held_piece_->h},
                              "Several slips come to rest at one instant",
                              "one slip that comes to rest, or several that all directions bring to rest together",
                              "slips that a direction brings to rest one after the other",
                              "Start elsewhere; on_kink='taken' gives the derivative of what was taken"));
  }
}

// What sticks from a held step on: where it stuck before, or as it is at the start of the step, where columns are.
std::vector<ContactPieces::Anchor> ContactPieces::held_anchors(const RunColumns& columns) const {
  std::vector<Anchor> found;
  const std::vector<PersistentContact>& contacts = held_piece_->held->contacts;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const PersistentContact& c = contacts[i];
    if (!c.keeps_place()) continue;
    found.push_back(
        {c.point, c.anchored ? anchor_of(c.point)->change : MatX(held_->start_place_change(i) * columns.q)});
  }
  return found;
}

// The changes of the coefficients of friction of the contacts of a step; empty where none changes.
VecX ContactPieces::friction_change(const RunDirections& d, Eigen::Index column) const {
  VecX dmu;
  if (d.mu.size() == 0) return dmu;
  const std::size_t count = held_piece_ != nullptr ? held_piece_->held->contacts.size() : step_->contacts.size();
  dmu.resize(static_cast<Eigen::Index>(count));
  for (std::size_t i = 0; i < count; ++i) {
    const PersistentContact& before =
        held_piece_ != nullptr ? held_piece_->held->contacts[i] : step_->contacts[i].before;
    dmu[static_cast<Eigen::Index>(i)] = takes_friction(*scene_, before) ? d.mu(before.point.guard, column) : 0.0;
  }
  return dmu;
}

void check_end_rate(const Piece& piece, bool by_force, double rate) {
  if (std::abs(rate) > 0.0) return;
  throw NoDerivative({by_force ? "release" : "stick", -1, piece.t + piece.h}, "The end of a contact is grazing",
                     "a slip or a force that falls to zero", "one that stays", "Start elsewhere");
}

bool ends_by_force(const Piece& piece, HeldStepTangent& step, const PieceInputs& inputs, EndForce& force) {
  const HeldStepEnd ending = piece.held->ending;
  if (piece.end != PieceEnd::kLength || (ending != HeldStepEnd::kRelease && ending != HeldStepEnd::kSlip)) return false;
  try {
    force.take(step.phase_end(), inputs.tau(), inputs.servo());
  } catch (const NoDerivative&) {
    return false;
  }
  return true;
}

bool has_own_end(const ContactStepRecord& step, const ContactStepTangent& tangent, const PieceInputs& inputs,
                 EndForce& force, Kinks& kinks) {
  if (step.ending == ContactStepEnd::kStick) return tangent.slip_ends();
  if (step.ending != ContactStepEnd::kRelease) return step.ending == ContactStepEnd::kImpact;
  try {
    force.take(release_of(step), inputs.tau(), inputs.servo());
  } catch (const NoDerivative& obstacle) {
    kinks.meet(obstacle);
    return false;
  }
  return true;
}

// The end of a piece where a contact changes without an impact: a slip comes to rest, or a force to zero.
void ContactPieces::end(bool by_force, const RunDirections& d, RunColumns& columns) {
  VecX fq(columns.q.rows()), fp(columns.q.rows()), later(d.count);
  solve_length(fq, fp);
  const double rate = by_force                 ? force_.rate(fq, fp)
                      : held_piece_ != nullptr ? held_->slip_changes()[0]
                                               : tangent_.slip_change();
  check_end_rate(*piece_, by_force, rate);
  for (Eigen::Index k = 0; k < d.count; ++k) {
    VecX tau = d.tau.size() > 0 ? VecX(d.tau.col(k)) : VecX();
    if (held_piece_ != nullptr) inputs_->mask(tau);
    double change = slip_[k];
    if (by_force) change = force_.change(columns.q.col(k), columns.p.col(k), tau, friction_change(d, k));
    if (by_force && d.parameter(k) != nullptr) change += force_.change(*d.parameter(k));
    later[k] = -change / rate;
  }
  columns.move_on(later, fq, fp);
}

void ContactPieces::keep_anchors(const RunColumns& columns) {
  if (held_piece_ != nullptr) {
    anchors_ = std::move(held_anchors_);
    const std::vector<FrictionJoint>& joints = held_piece_->held->joints;
    for (std::size_t j = 0; j < joints.size(); ++j)
      if (joints[j].sticks) joint_anchors_.row(static_cast<Eigen::Index>(j)) = columns.q.row(joints[j].dof);
    return;
  }
  if (dense_step_ != nullptr) {  // contacts stick without an anchor after it
    anchors_.clear();
    return;
  }
  const Eigen::Index count = columns.q.cols();
  std::vector<Anchor> now;
  for (std::size_t i = 0; i < step_->contacts.size(); ++i) {
    const PersistentContact& before = step_->contacts[i].before;
    const ContactOutcome& out = step_->contacts[i].outcome;
    if (!before.point.material || out.slips) continue;
    Anchor anchor{before.point, MatX()};
    if (before.anchored && !out.slipped) {
      anchor.change = anchor_of(before.point)->change;
    } else {
      anchor.change.resize(3, count);
      for (Eigen::Index k = 0; k < count; ++k)
        anchor.change.col(k) = tangent_.place_change(static_cast<int>(i), columns.q.col(k));
    }
    now.push_back(std::move(anchor));
  }
  anchors_ = std::move(now);
  for (std::size_t j = 0; j < step_->joints.size(); ++j) {
    const ContactStepRecord::Joint& joint = step_->joints[j];
    if (joint.sticks && !joint.anchored) joint_anchors_.row(static_cast<Eigen::Index>(j)) = columns.q.row(joint.dof);
  }
}

}  // namespace contactvi
