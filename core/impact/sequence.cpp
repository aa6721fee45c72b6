#include "impact/sequence.hpp"

#include <algorithm>
#include <cmath>

#include "impact/ctec.hpp"
#include "impact/impact_maps.hpp"
#include "model/restitution.hpp"

namespace contactvi {

namespace {
constexpr double kSeparated = 1e-13;    // of the event's speeds: a smaller closing speed is rounding
constexpr double kEndlessSpeed = 1e-9;  // of the event's speeds: below it an endless sequence goes on with e = 0
constexpr double kAtRest = 1e-11;       // [m/s] as kEndlessSpeed
// Of all speeds: as kEndlessSpeed, beside persistent contacts; the flights are then 1e-15 m high.
constexpr double kLowBounce = 1e-7;
constexpr double kFloor = 2e-14;  // of all speeds: rounding
constexpr double kTie = 1e-12;    // of the speeds: contacts that differ by less close equally fast
// Impacts per inelastic contact at one instant after which the sequence counts as endless; beside persistent contacts
// the first number.
constexpr int kFewImpacts = 32, kManyImpacts = 256;
constexpr double kOnCone = 1e-10;  // of the friction limit: beyond the cone by less is rounding
}  // namespace

ImpactSequence::ImpactSequence(const Scene& scene, Integrator& integrator, Guards& guards, const ImpactOptions& options)
    : scene_(&scene),
      integrator_(&integrator),
      guards_(&guards),
      options_(options),
      law_(&impact_law(options.map)),
      constraint_impulses_(VecX::Zero(scene.tree.elements.constraint_rows)),
      projection_(scene.tree),
      q_(scene.tree.nq),
      v_(scene.tree.nv) {}

bool ImpactSequence::fail(StatusCode code, const char* message, int guard) {
  code_ = code;
  message_ = message;
  guard_ = guard;
  return false;
}

// Where an impact was not solved: driven constraints may leave the contacts no solution.
bool ImpactSequence::fail_unsolved(const char* message, int guard) {
  if (!scene_->tree.elements.driven()) return fail(StatusCode::kImpactUnsolved, message, guard);
  return fail(StatusCode::kConstraint, "what the constraints drive leaves these contacts no way out", guard);
}

double ImpactSequence::largest_speed(const VecX& p) const {
  double largest = 0.0;
  for (int i = 0; i < count_; ++i)
    for (int k = 0; k < closed_[i].count; ++k) largest = std::max(largest, std::abs(closed_[i].gamma_n(k, p)));
  return largest;
}

// Sets `worst` to the elastic contact that closes fastest, null if none closes. False: it closes so slowly that the
// sequence goes on with e = 0.
bool ImpactSequence::find_fastest(const VecX& p, const std::vector<char>& plastic, double scale, bool elastic,
                                  ClosedGuard*& worst) {
  worst = nullptr;
  double gamma = -std::max(kSeparated * scale, kFloor * speeds_);
  for (int i = 0; i < count_; ++i) {
    ClosedGuard& c = closed_[i];
    if (c.e == 0.0 || plastic[c.guard]) continue;
    const double candidate = c.gamma_n(p);
    if (!(candidate < gamma * (worst == nullptr ? 1.0 : 1.0 + kTie))) continue;
    gamma = candidate;
    worst = &c;
  }
  // Beside persistent contacts the sequence is followed down to a larger speed only.
  const double low = std::max(kAtRest, any_persistent_ && !elastic ? kLowBounce * speeds_ : 0.0);
  return worst == nullptr || gamma <= -std::max(kEndlessSpeed * scale, low);
}

// Coefficient of a contact that closes at p. Its speeds are those of the point that closes fastest.
double ImpactSequence::restitution(const ClosedGuard& closed, const VecX& p) const {
  const ContactLaw* law = scene_->law(closed.guard);
  if (law == nullptr || !restitution_varies(*law)) return closed.e;
  int first = 0;
  for (int i = 1; i < closed.count; ++i)
    if (closed.gamma_n(i, p) < closed.gamma_n(first, p)) first = i;
  const int r = first * closed.rows_per_point();
  const double slip = closed.rows_per_point() == 1 ? 0.0
                                                   : std::hypot(closed.speed(r + 1, p) / law->shares[0],
                                                                closed.speed(r + 2, p) / law->shares[1]);
  return restitution_at(*law, std::max(0.0, -closed.gamma_n(p)), slip, time_);
}

bool ImpactSequence::run(const Instant& at, const std::vector<char>& plastic, ImpactReference& reference, VecX& p,
                         Recording& recording) {
  code_ = StatusCode::kSuccess;
  reference_ = &reference;
  impacts_ = 0;
  constraint_impulses_.setZero();
  driven_work_ = 0.0;
  speeds_ = 0.0;
  for (int i = 0; i < count_; ++i) {
    const auto MinvW = closed_[i].MinvW.leftCols(closed_[i].rows);
    speeds_ = std::max(speeds_, (MinvW.cwiseAbs().transpose() * p.cwiseAbs()).maxCoeff());
  }
  const double scale = largest_speed(p);
  bool elastic = false;  // without losses a long sequence may still end
  for (int i = 0; i < count_; ++i) elastic |= closed_[i].e == 1.0;
  for (int impacts = 0;; ++impacts) {
    ClosedGuard* worst = nullptr;
    const bool endless = !elastic && impacts >= (any_persistent_ ? kFewImpacts : kManyImpacts) * count_;
    const bool goes_on = find_fastest(p, plastic, scale, elastic, worst) && !endless;
    if (goes_on) {
      if (worst != nullptr) {
        const bool single = worst->count == 1 && worst->mu == 0.0 && !(options_.stiff_support && any_persistent_);
        const double e = restitution(*worst, p);
        if (!std::isfinite(e))
          return fail(StatusCode::kNotFinite, "a coefficient of restitution is not finite", worst->guard);
        if (!(single ? impact_at_point(*worst, e, at, p, recording) : impact_of_contact(*worst, e, at, p, recording)))
          return false;
        if (++impacts_in_step_ > options_.max_impacts_per_step)
          return fail(StatusCode::kTooManyImpacts, "too many impacts in one step", worst->guard);
        continue;
      }
    }
    bool any = false;
    if (!plastic_impact(plastic, !goes_on, at, scale, p, any, recording)) return false;
    if (!any) {
      if (add_unused_point(p)) continue;
      return true;
    }
    if (++impacts_in_step_ > options_.max_impacts_per_step)
      return fail(StatusCode::kTooManyImpacts, "too many impacts in one step", count_ > 0 ? closed_[0].guard : -1);
  }
}

// After a fallback the scalar is what it is: the next impact must not be made to pay the difference back. A reference
// that is carried through the run keeps its value.
void ImpactSequence::carry_over(const ImpactResult& result) {
  if (result.fallback == Fallback::kNone || reference_->kind == MhcReference::kRun) return;
  if (std::isfinite(result.jump)) reference_->value += result.jump;
}

// One point without friction: the maps as they are.
bool ImpactSequence::impact_at_point(ClosedGuard& closed, double e, const Instant& at, VecX& p, Recording& recording) {
  const VecX p_minus = p, W = closed.W.col(0), MinvW = closed.MinvW.col(0);
  const bool implicit = is_implicit(at);
  Stepper& rest = implicit ? *at.rest : *integrator_;
  const double gamma = closed.speed(0, p), G_c = W.dot(MinvW);
  ImpactProblem problem{rest, q_,      p_minus, W,        MinvW,  gamma, G_c, closed.offset[0],
                        e,    at.time, at.dt,   at.after, at.tau, 0.0};
  reference_->value -= problem.loss();
  problem.target = reference_->value;
  ImpactResult result = implicit ? law_->apply(problem, p) : explicit_impulse(problem, p);
  if (law_->implicit() && !implicit) result.fallback = Fallback::kPersistent;
  if (!result.ok) return fail(StatusCode::kImpactUnsolved, "an impact has no finite impulse", closed.guard);
  carry_over(result);
  closed.impacted = true;
  VecX lambda = VecX::Constant(1, result.impulse);
  record(closed, lambda, p_minus, p, result, e, problem.loss(), gamma, closed.speed(0, p), at, recording);
  return true;
}

// The impulse of an implicit map for an impact with friction or several points: the normal impulses on all points are
// scaled by one factor.
ImpactResult ImpactSequence::correct_impulse(const ClosedGuard& closed, const ImpactBlockResult& block, double e,
                                             const Instant& at, VecX& p) {
  ImpactResult ctec;
  ctec.ok = true;
  const int m = closed.rows_per_point();
  for (int i = 0; i < closed.count; ++i) ctec.impulse += block.lambda[m * i];
  VecX W = VecX::Zero(p.size()), MinvW = W;
  double offset = 0.0;
  for (int i = 0; i < closed.count && ctec.impulse > 0.0; ++i) {
    const double share = block.lambda[m * i] / ctec.impulse;
    W += share * closed.W.col(m * i);
    MinvW += share * closed.MinvW.col(m * i);
    offset += share * closed.offset[m * i];
  }
  ImpactResult result = ctec;
  if (!law_->implicit()) return result;
  if (!is_implicit(at) || !(ctec.impulse > 0.0)) {
    result.fallback = Fallback::kPersistent;
    return result;
  }
  const VecX base = p - ctec.impulse * W;  // so that p = base + impulse W
  const double G_c = W.dot(MinvW), gamma = MinvW.dot(base) + offset;
  // Friction has done its part of the work of prescribed motions.
  const double friction = closed.offset.head(closed.rows).dot(block.lambda.head(closed.rows)) - ctec.impulse * offset;
  ImpactProblem problem{*at.rest, q_, base,    W,     MinvW,    gamma,  G_c,
                        offset,   e,  at.time, at.dt, at.after, at.tau, reference_->value - friction};
  result = law_->correct(problem, ctec, p);
  const bool closes = closed.gamma_n(p) < -kSolved * speeds_;
  if (!closes && !leaves_friction_cone(closed, block.lambda, result.impulse)) return result;
  // The correction scales the normal impulses. Where friction would then be outside of its cone, or one of the points
  // close, CTEC's impulse is kept.
  problem.restitution = 0.0;
  result = law_->correct(problem, ctec, p);
  result.fallback = Fallback::kInadmissible;
  return result;
}

// Whether friction would be too large for the normal impulses scaled to a total of `normal`.
bool ImpactSequence::leaves_friction_cone(const ClosedGuard& closed, const VecX& lambda, double normal) const {
  if (closed.mu == 0.0) return false;
  const int m = closed.rows_per_point(), friction = closed.spinning > 0.0 ? 3 : 2;
  double before = 0.0;
  for (int i = 0; i < closed.count; ++i) before += lambda[m * i];
  if (!(before > 0.0) || normal >= before) return false;
  const double share = normal / before;
  for (int i = 0; i < closed.count; ++i) {
    const double most = share * lambda[m * i] * (1.0 + kOnCone);
    if (lambda.segment(m * i + 1, friction).norm() > closed.mu * most) return true;
    if (closed.rolling > 0.0 && lambda.segment<2>(m * i + 1 + friction).norm() > most) return true;
  }
  return false;
}

// Whether impulses on the points of a contact change the velocities there by rounding alone: those of contacts that
// take part in an impact of others, which does not reach them.
bool ImpactSequence::is_rounding(const ClosedGuard& closed, const VecX& lambda) const {
  const auto W = closed.W.leftCols(closed.rows), MinvW = closed.MinvW.leftCols(closed.rows);
  return (W.transpose() * (MinvW * lambda)).cwiseAbs().maxCoeff() <= kFloor * speeds_;
}

bool ImpactSequence::impact_of_contact(ClosedGuard& closed, double e, const Instant& at, VecX& p,
                                       Recording& recording) {
  std::vector<BlockMember> members{{&closed, e}};
  if (options_.stiff_support)
    for (int i = 0; i < count_; ++i)
      if (closed_[i].persistent && &closed_[i] != &closed) members.push_back({&closed_[i], 0.0});
  const ImpactBlockResult block = impact_block_.solve(members, p, scene_->law(closed.guard));
  if (!block.ok) return fail_unsolved("an impact with friction was not solved", closed.guard);
  reference_->value -= block.loss;
  const std::size_t first = recording.impacts.size();
  VecX p_minus = p;
  for (std::size_t k = 1; k < members.size(); ++k) {
    // The reactions of the supports are recorded first.
    ClosedGuard& support = *members[k].closed;
    int row = 0;
    for (std::size_t j = 0; j < k; ++j) row += members[j].closed->rows;
    const VecX lambda = block.lambda.segment(row, support.rows);
    if (is_rounding(support, lambda)) continue;
    p = p_minus + support.W.leftCols(support.rows) * lambda;
    ImpactResult result;
    result.impulse = lambda.sum();
    support.impacted = true;
    const double loss = support.loss(lambda, p_minus, p);
    record(support, lambda, p_minus, p, result, 0.0, loss, block.gamma_minus.segment(row, support.rows).minCoeff(),
           block.gamma_plus.segment(row, support.rows).minCoeff(), at, recording);
    p_minus = p;
  }
  VecX lambda = block.lambda.head(closed.rows);
  p = p_minus + closed.W.leftCols(closed.rows) * lambda;
  const double loss = closed.loss(lambda, p_minus, p);
  const double gamma = closed.gamma_n(p_minus);
  ImpactResult result = correct_impulse(closed, block, e, at, p);
  result.iterations += block.iterations;
  if (block.gain > 0.0 && result.fallback == Fallback::kNone) result.fallback = Fallback::kGain;
  if (!result.ok || !p.allFinite())
    return fail(StatusCode::kImpactUnsolved, "an impact has no finite impulse", closed.guard);
  carry_over(result);
  closed.impacted = true;
  const int m = closed.rows_per_point();
  double normal = 0.0;
  for (int i = 0; i < closed.count; ++i) normal += lambda[m * i];
  for (int i = 0; i < closed.count && normal > 0.0; ++i) lambda[m * i] *= result.impulse / normal;
  record(closed, lambda, p_minus, p, result, e * block.restitution, loss, gamma, closed.gamma_n(p), at, recording);
  if (options_.keep_blocks) keep_block(members, first, recording);
  return true;
}

// The plastic contacts together as one problem, or all contacts where an endless sequence ends. any: whether an impulse
// acted.
bool ImpactSequence::plastic_impact(const std::vector<char>& plastic, bool all, const Instant& at, double scale,
                                    VecX& p, bool& any, Recording& recording) {
  std::vector<BlockMember> members;
  any = false;
  const double closing = std::max(kSeparated * scale, (impacts_ > 0 ? kSolved : kFloor) * speeds_);
  for (int i = 0; i < count_; ++i) {
    ClosedGuard& c = closed_[i];
    if (!all && c.e > 0.0 && !plastic[c.guard]) continue;
    any |= c.gamma_n(p) < -closing;
    members.push_back({&c, 0.0});
  }
  if (!any) return true;
  const ContactLaw* law = members.size() == 1 ? scene_->law(members[0].closed->guard) : nullptr;
  const ImpactBlockResult block = impact_block_.solve(members, p, law);
  if (!block.ok) return fail_unsolved("a plastic impact was not solved", members[0].closed->guard);
  reference_->value -= block.loss;
  const std::size_t first = recording.impacts.size();
  int row = 0;
  bool acted = false;
  for (const BlockMember& member : members) {
    ClosedGuard& c = *member.closed;
    const VecX lambda = block.lambda.segment(row, c.rows);
    const int m = c.rows_per_point();
    double least = 0.0, after = INFINITY;
    for (int i = 0; i < c.count; ++i) {
      least = std::min(least, block.gamma_minus[row + m * i]);
      after = std::min(after, block.gamma_plus[row + m * i]);
    }
    row += c.rows;
    if (is_rounding(c, lambda)) continue;
    acted = true;
    const VecX p_minus = p;
    p += c.W.leftCols(c.rows) * lambda;
    ImpactResult result;
    for (int i = 0; i < c.count; ++i) result.impulse += lambda[m * i];
    result.iterations = block.iterations;
    if (law_->implicit()) result.fallback = is_implicit(at) ? Fallback::kPlastic : Fallback::kPersistent;
    c.impacted = true;
    const double loss = c.loss(lambda, p_minus, p);
    record(c, lambda, p_minus, p, result, 0.0, loss, least, after, at, recording);
  }
  if (!p.allFinite())
    return fail(StatusCode::kImpactUnsolved, "an impact has no finite impulse", members[0].closed->guard);
  if (acted && options_.keep_blocks) keep_block(members, first, recording);
  any = acted;  // a closing speed below the accuracy of the problem is zero
  return true;
}

// Keeps an impact whose records are those from `first` on, if several points took part.
void ImpactSequence::keep_block(const std::vector<BlockMember>& members, std::size_t first,
                                const Recording& recording) {
  ImpactBlockRecord block;
  std::size_t points = 0;
  for (const BlockMember& member : members) {
    const ClosedGuard& c = *member.closed;
    block.members.push_back({c.guard, member.e, {c.points.begin(), c.points.begin() + c.count}});
    points += block.members.back().points.size();
  }
  if (points < 2) return;
  const ImpactRecord& record = recording.impacts[first];
  block.impacts = static_cast<int>(recording.impacts.size() - first);
  block.time = record.time;
  block.impulse = record.impulse;
  block.guard = record.guard;
  blocks_.push_back(std::move(block));
}

void ImpactSequence::record(const ClosedGuard& closed, const VecX& lambda, const VecX& p_minus, const VecX& p_plus,
                            const ImpactResult& result, double e, double loss, double gamma_minus, double gamma_plus,
                            const Instant& at, Recording& recording) {
  ++impacts_;
  if (projection_.any()) constraint_impulses_ -= closed.mu_fixed.leftCols(closed.rows) * lambda;
  if (projection_.any() || guards_->moves(closed.guard)) {
    const double done = -closed.offset.head(closed.rows).dot(lambda);
    driven_work_ += done;
    reference_->value += done;
  }
  ImpactRecord r;
  const int m = closed.rows_per_point();
  double weight = 0.0;
  int deepest = 0;
  r.impulse_vector.setZero();
  r.point.setZero();
  for (int i = 0; i < closed.count; ++i) {
    const Contact& c = closed.contacts[i];
    const Vec3 middle = 0.5 * (c.point_a + c.point_b);
    Vec3 impulse = lambda[m * i] * c.normal;
    if (m >= 3) impulse += guards_->frame(closed.guard, c, closed.t1[i]).force(lambda.segment<2>(m * i + 1));
    r.impulse_vector += impulse;
    r.point += lambda[m * i] * middle;
    weight += lambda[m * i];
    if (c.gap < closed.contacts[deepest].gap) deepest = i;
    if (options_.record_contacts && scene_->is_pair(closed.guard))
      recording.contacts.push_back({at.time, 0.0, closed.guard, closed.points[i].feature, ContactMode::kImpact, at.step,
                                    middle, c.normal, impulse, Vec3::Zero(), c.gap, Vec3::Zero()});
  }
  const Contact& c = closed.contacts[deepest];
  if (closed.count == 1 && m == 1) r.impulse_vector = result.impulse * c.normal;
  r.point = weight > 0.0 && closed.count > 1 ? Vec3(r.point / weight) : Vec3(0.5 * (c.point_a + c.point_b));
  // By rounding a partial step may end slightly before the last one: times of impacts must not decrease.
  r.time = recording.impacts.empty() ? at.time : std::max(at.time, recording.impacts.back().time);
  r.guard = closed.guard;
  r.normal = c.normal;
  r.impulse = result.impulse;
  r.gamma_minus = gamma_minus;
  r.gamma_plus = gamma_plus;
  r.G_c = closed.W.col(m * deepest).dot(closed.MinvW.col(m * deepest));
  r.gap = c.gap;
  r.restitution = e;
  r.friction = closed.mu;
  r.points = closed.count;
  r.loss = loss;
  r.method = static_cast<int>(options_.map);
  r.iterations = result.iterations;
  r.fallback = static_cast<int>(result.fallback);
  r.jump = result.jump;
  r.before = at.before;
  r.after = at.after;
  r.step = at.step;
  r.q = q_;
  r.p_minus = p_minus;
  r.p_plus = p_plus;
  recording.impacts.push_back(std::move(r));
}

}  // namespace contactvi
