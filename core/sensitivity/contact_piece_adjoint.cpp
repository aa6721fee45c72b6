#include "sensitivity/contact_piece_adjoint.hpp"

#include "sensitivity/contact_pieces.hpp"
#include "sensitivity/known_laws.hpp"

namespace contactvi {

ContactPieceAdjoint::ContactPieceAdjoint(const Scene& scene, const RecordedRun& run, Kinks& kinks)
    : scene_(&scene), run_(&run), adjoint_(scene, kinks), kinks_(&kinks), force_(scene, run) {}

void ContactPieceAdjoint::start() {
  anchors_.clear();
  joint_anchors_.setZero(static_cast<Eigen::Index>(scene_->tree.elements.friction_dofs.size()));
}

void ContactPieceAdjoint::take(const Piece& piece, const PieceInputs& inputs) {
  if (piece.held == nullptr) check_contact_piece(*run_, piece);
  piece_ = &piece;
  step_ = piece.contact;
  dense_step_ = piece.dense;
  held_piece_ = piece.held != nullptr ? &piece : nullptr;
  inputs_ = &inputs;
  number_ = piece.step;
  if (held_piece_ != nullptr) {
    if (!held_) held_ = std::make_unique<HeldStepAdjoint>(*scene_, run_->stages, run_->contact_points, *kinks_);
    held_->take(*piece.held, inputs.tau(), inputs.servo());
    force_ends_ = ends_by_force(piece, held_->tangent(), inputs, force_);
    return;
  }
  if (dense_step_ != nullptr) {
    if (!dense_) dense_ = std::make_unique<DenseStepAdjoint>(*scene_, *kinks_);
    dense_->take(*dense_step_, inputs.tau(), inputs.servo());
    return;
  }
  adjoint_.take(*step_, inputs.tau(), inputs.servo());
}

void ContactPieceAdjoint::solve_length(VecRef fq, VecRef fp) {
  ContactStepDirection direction;
  direction.h = 1.0;
  if (held_piece_ != nullptr) return held_->tangent().solve(direction, fq, fp);
  adjoint_.tangent().solve(direction, fq, fp);
}

// The gradient in the place of a point, which is taken off the list.
Vec3 ContactPieceAdjoint::take_anchor(const ContactPoint& point) {
  for (std::size_t k = 0; k < anchors_.size(); ++k) {
    if (!same_point(anchors_[k].point, point)) continue;
    const Vec3 found = anchors_[k].gradient;
    anchors_.erase(anchors_.begin() + static_cast<std::ptrdiff_t>(k));
    return found;
  }
  return Vec3::Zero();
}

void ContactPieceAdjoint::leave_anchors(VecX& lq) {
  if (held_piece_ != nullptr) return leave_held_anchors(lq);
  if (dense_step_ != nullptr) {  // contacts stick without an anchor after it
    finish();
    return;
  }
  std::vector<Anchor> before;
  for (std::size_t i = 0; i < step_->contacts.size(); ++i) {
    const PersistentContact& contact = step_->contacts[i].before;
    const ContactOutcome& out = step_->contacts[i].outcome;
    if (!contact.point.material || out.slips) continue;
    const Vec3 gradient = take_anchor(contact.point);
    if (contact.anchored && !out.slipped) {
      before.push_back({contact.point, step_->t, gradient});
    } else if (!gradient.isZero(0)) {
      lq += adjoint_.place_gradient(static_cast<int>(i), gradient);
    }
  }
  finish();
  anchors_ = std::move(before);
  for (std::size_t j = 0; j < step_->joints.size(); ++j) {
    const ContactStepRecord::Joint& joint = step_->joints[j];
    if (!joint.sticks || joint.anchored) continue;
    lq[joint.dof] += joint_anchors_[static_cast<Eigen::Index>(j)];
    joint_anchors_[static_cast<Eigen::Index>(j)] = 0.0;
  }
}

// They count from the start of the step, or from where they stuck before it.
void ContactPieceAdjoint::leave_held_anchors(VecX& lq) {
  const std::vector<PersistentContact>& contacts = held_piece_->held->contacts;
  held_anchors_.setZero(3, static_cast<Eigen::Index>(contacts.size()));
  for (std::size_t i = 0; i < contacts.size(); ++i)
    if (contacts[i].keeps_place()) held_anchors_.col(static_cast<Eigen::Index>(i)) = take_anchor(contacts[i].point);
  finish();
  anchors_.clear();
  const std::vector<FrictionJoint>& joints = held_piece_->held->joints;
  for (std::size_t j = 0; j < joints.size(); ++j) {
    if (!joints[j].sticks) continue;
    lq[joints[j].dof] += joint_anchors_[static_cast<Eigen::Index>(j)];
    joint_anchors_[static_cast<Eigen::Index>(j)] = 0.0;
  }
}

void ContactPieceAdjoint::finish() const {
  for (const Anchor& anchor : anchors_) refuse_sticking_start(anchor.point, anchor.time);
}

// The gradients in the start of a step that ends with an impact from that in the scalar that DTEC conserves.
void ContactPieceAdjoint::add_energy(double lenergy, VecX& lq, VecX& lp, double& ltime) {
  ContactStepDirection direction;
  VecX dq(lq.size()), dp(lq.size());
  const auto along = [&](double& entry) {
    entry = 1.0;
    adjoint_.tangent().solve(direction, dq, dp);
    entry = 0.0;
    return lenergy * energy_change();
  };
  ltime += along(direction.t) - along(direction.h);
  direction.q = direction.p = VecX::Zero(lq.size());
  for (Eigen::Index k = 0; k < lq.size(); ++k) {
    lq[k] += along(direction.q[k]);
    lp[k] += along(direction.p[k]);
  }
}

void ContactPieceAdjoint::pass(VecX& lq, VecX& lp, double& ltime, double lenergy, RunGradient& result) {
  if (dense_step_ != nullptr) {
    pass_dense(lq, lp, ltime, result);
    return;
  }
  if (held_piece_ != nullptr) return pass_held(lq, lp, ltime, result);
  const ContactStepRecord& s = *step_;
  const bool ends_itself = has_own_end(s, adjoint_.tangent(), *inputs_, force_, *kinks_);
  const double share = s.ending == ContactStepEnd::kLength ? s.share : 0.0;
  double lslip = 0.0;
  if (ends_itself && s.ending != ContactStepEnd::kImpact)
    lslip = pass_end(s.ending == ContactStepEnd::kRelease, lq, lp, ltime, result);
  result.begin_step();
  if (!adjoint_.solve(lq, lp, lslip, gradient_, result.parameters))
    throw NoDerivative({"step", -1, s.t}, "The derivative of a step was not solved",
                       "adjoint equations with a solution", "none", "Use a smaller dt");
  lq = gradient_.q;
  lp = gradient_.p;
  ltime = gradient_.t + (ends_itself ? -gradient_.h : ltime * (1.0 - share) - share * gradient_.h);
  if (lenergy != 0.0) add_energy(lenergy, lq, lp, ltime);
  result.end_step(number_, gradient_.tau);
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const PersistentContact& before = s.contacts[i].before;
    if (takes_friction(*scene_, before)) result.mu[before.point.guard] += gradient_.mu[static_cast<Eigen::Index>(i)];
    if (!before.anchored) continue;
    const Vec3 gradient = take_anchor(before.point) + gradient_.anchors.col(static_cast<Eigen::Index>(i));
    anchors_.push_back({before.point, s.t, gradient});
  }
  for (std::size_t j = 0; j < s.joints.size(); ++j)
    if (s.joints[j].anchored)
      joint_anchors_[static_cast<Eigen::Index>(j)] += gradient_.joints[static_cast<Eigen::Index>(j)];
}

void ContactPieceAdjoint::pass_dense(VecX& lq, VecX& lp, double& ltime, RunGradient& result) {
  const DenseStepRecord& s = *dense_step_;
  result.begin_step();
  if (!dense_->solve(lq, lp, dense_gradient_, result.parameters))
    throw NoDerivative({"step", -1, s.t}, "The derivative of a step was not solved",
                       "adjoint equations with a solution", "none", "Use a smaller dt");
  lq = dense_gradient_.q;
  lp = dense_gradient_.p;
  ltime = dense_gradient_.t + ltime * (1.0 - s.share) - s.share * dense_gradient_.h;
  result.end_step(number_, dense_gradient_.tau);
  for (std::size_t i = 0; i < s.contacts.size(); ++i) {
    const DenseStepRecord::Contact& c = s.contacts[i];
    if (c.mu > 0.0) result.mu[c.point.guard] += dense_gradient_.mu[static_cast<Eigen::Index>(i)];
    result.e[c.point.guard] += dense_gradient_.e[static_cast<Eigen::Index>(i)];
  }
}

void ContactPieceAdjoint::pass_held(VecX& lq, VecX& lp, double& ltime, RunGradient& result) {
  double lslip = 0.0;
  if (held_piece_->ends_itself() || force_ends_) lslip = pass_end(force_ends_, lq, lp, ltime, result);
  result.begin_step();
  if (!held_->solve(lq, lp, lslip, gradient_, result.parameters))
    throw NoDerivative({"step", -1, held_piece_->t}, "The derivative of a step was not solved",
                       "adjoint equations with a solution", "none", "Use a smaller dt");
  lq = gradient_.q;
  lp = gradient_.p;
  const std::vector<PersistentContact>& contacts = held_piece_->held->contacts;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    if (takes_friction(*scene_, contacts[i]))
      result.mu[contacts[i].point.guard] += gradient_.mu[static_cast<Eigen::Index>(i)];
    if (!contacts[i].keeps_place()) continue;
    const Vec3 gradient = held_anchors_.col(static_cast<Eigen::Index>(i));
    if (contacts[i].anchored) {
      anchors_.push_back(
          {contacts[i].point, held_piece_->t, gradient + gradient_.anchors.col(static_cast<Eigen::Index>(i))});
    } else {
      lq += held_->tangent().start_place_change(i).transpose() * gradient;
    }
  }
  const double later = held_piece_->end == PieceEnd::kLength && !force_ends_ ? ltime : -gradient_.h;
  ltime = gradient_.t + later;
  inputs_->mask(gradient_.tau);
  result.end_step(number_, gradient_.tau);
}

// A slip that comes to rest, or a force that comes to zero: the gradient in that slip.
double ContactPieceAdjoint::pass_end(bool by_force, VecX& lq, VecX& lp, double& ltime, RunGradient& result) {
  VecX fq(lq.size()), fp(lq.size());
  solve_length(fq, fp);
  const double rate = by_force                 ? force_.rate(fq, fp)
                      : held_piece_ != nullptr ? held_->tangent().slip_changes()[0]
                                               : adjoint_.tangent().slip_change();
  check_end_rate(*piece_, by_force, rate);
  const double gradient = -(lq.dot(fq) + lp.dot(fp) + ltime) / rate;
  ltime = 0.0;
  if (!by_force) return gradient;
  pass_force(gradient, lq, lp, result);
  return 0.0;
}

void ContactPieceAdjoint::pass_force(double lforce, VecX& lq, VecX& lp, RunGradient& result) {
  const std::vector<PhaseEnd::Contact>& contacts = force_.end().contacts;
  const Eigen::Index n = lq.size(), count = static_cast<Eigen::Index>(contacts.size());
  const VecX none = VecX::Zero(n), empty;
  const auto along = [&](const VecX& dq, const VecX& dp, const VecX& dtau, const VecX& dmu) {
    return lforce * force_.change(dq, dp, dtau, dmu);
  };
  VecX momentum(n), force(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const VecX unit = VecX::Unit(n, k);
    lq[k] += along(unit, none, empty, empty);
    momentum[k] = along(none, unit, empty, empty);
    force[k] = along(none, none, unit, empty);
  }
  lp += momentum;
  result.begin_step();
  force_.add_parameters(momentum, force, result.parameters);
  if (held_piece_ != nullptr) inputs_->mask(force);
  result.end_step(number_, force);
  for (Eigen::Index i = 0; i < count; ++i) {
    const PersistentContact& before = contacts[static_cast<std::size_t>(i)].before;
    if (takes_friction(*scene_, before))
      result.mu[before.point.guard] += along(none, none, empty, VecX::Unit(count, i));
  }
}

}  // namespace contactvi
