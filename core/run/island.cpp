#include "run/island.hpp"

#include <algorithm>
#include <cmath>

#include "geometry/prepare.hpp"
#include "model/force_rate.hpp"

namespace contactvi {

namespace {

// In a path that is followed from impact to impact: one that hops more often in an interval stays where it is.
constexpr std::size_t kMostBends = 8;

int position(const std::vector<int>& sorted, int value) {
  const auto at = std::lower_bound(sorted.begin(), sorted.end(), value);
  return at != sorted.end() && *at == value ? static_cast<int>(at - sorted.begin()) : -1;
}

// Whether some force or constraint is a function of time, or may be one.
bool depends_on_time(const Elements& e) { return e.driven() || !e.potentials.empty() || forces_depend_on_time(e); }

// How far a change of each coordinate by 1 moves the points of a body, at most 1 [m]. What turns freely and is smaller
// than that turns within the rounding of its points.
VecX turning_levers(const Scene& scene) {
  VecX levers = VecX::Ones(scene.tree.nq);
  std::vector<double> reach(scene.tree.joints.size(), 0.0);
  for (const Geometry& g : scene.geometries)
    if (g.body >= 0 && !g.unbounded) reach[g.body] = std::max(reach[g.body], g.reach);
  for (std::size_t j = 0; j < reach.size(); ++j) {
    const Joint& joint = scene.tree.joints[j];
    if (joint.nq == 4 && reach[j] > 0.0) levers.segment<4>(joint.iq).setConstant(std::min(1.0, reach[j]));
  }
  return levers;
}

// The step lengths of two islands that become one.
void combine(const StepControl& part, StepControl& all) {
  all.free.longest = std::min(all.free.longest, part.free.longest);
  all.free.solved_in_row = std::min(all.free.solved_in_row, part.free.solved_in_row);
  all.contact.longest = std::min(all.contact.longest, part.contact.longest);
  all.contact.solved_in_row = std::min(all.contact.solved_in_row, part.contact.solved_in_row);
  if (part.flight > 0.0 && (all.flight == 0.0 || part.flight < all.flight)) all.flight = part.flight;
  all.without_progress = std::max(all.without_progress, part.without_progress);
}

const Scene& prepared(Scene& scene) {
  prepare_geometry(scene);
  return scene;
}

}  // namespace

Island::Island(const Scene& whole, const StaticTrees& all, std::vector<int> trees, const SimulatorOptions& options)
    : trees_(std::move(trees)),
      numbers_(restrict_scene(whole, all, trees_)),
      own_(std::make_unique<Simulator>(prepared(numbers_->scene), options)),
      engine_(own_.get()),
      fresh_(engine_->memory()) {
  begin(whole, all);
}

Island::Island(const Scene& whole, const StaticTrees& all, std::vector<int> trees, Simulator& engine)
    : trees_(std::move(trees)), numbers_(whole_scene_numbers(whole)), engine_(&engine), fresh_(engine_->memory()) {
  begin(whole, all);
}

void Island::begin(const Scene& whole, const StaticTrees& all) {
  for (int g : numbers_->guards) guard_trees_.push_back(all.of_guard(whole, g));
  offset_.assign(numbers_->geometries.size(), 0.0);
  levers_ = turning_levers(engine_->scene());
  find_bases(all);
  engine_->follow_motion();
  depends_on_time_ = depends_on_time(engine_->scene().tree.elements) || engine_->scene().contacts_depend_on_time();
  for (int d : numbers_->v) dof_tree_.push_back(all.of_joint(whole.tree.dof_joint[d]));
}

void Island::find_bases(const StaticTrees& all) {
  const Scene& scene = engine_->scene();
  const Tree& tree = scene.tree;
  std::vector<int> base, members;  // of each joint, of each base
  for (std::size_t j = 0; j < tree.joints.size(); ++j) {
    const Joint& joint = tree.joints[j];
    base.push_back(joint.parent < 0 ? -1 : base[joint.parent]);
    if (joint.parent < 0 && joint.type == JointType::kTranslation) {
      base.back() = static_cast<int>(bases_.size());
      bases_.push_back({joint.iq,
                        joint.iv,
                        all.of_joint(numbers_->joints[j]),
                        joint.R_PJ,
                        -1,
                        0.0,
                        Vec3::Zero(),
                        {},
                        0.0,
                        0.0,
                        false});
      members.push_back(0);
    }
    if (base.back() < 0) continue;
    const bool turns = joint.type == JointType::kSpherical && joint.parent >= 0;
    members[base.back()] += joint.parent < 0 || turns ? 1 : 3;
    bases_[base.back()].mass += joint.mass;
    if (turns) bases_[base.back()].turning = joint.iq;
  }
  const Elements& e = tree.elements;
  const bool weight_alone = !tree.has_springs && !tree.has_damping && !e.any_force() && e.constraints.empty() &&
                            e.servo_kp.size() == 0 && tree.followers.empty();
  for (std::size_t k = 0; k < bases_.size(); ++k)
    if (!weight_alone || members[k] > 2) {
      bases_[k].mass = 0.0;
      bases_[k].turning = -1;
    }
  for (const Geometry& g : scene.geometries) {
    base_of_.push_back(g.body < 0 ? -1 : base[g.body]);
    only_translates_.push_back(base_of_.back() >= 0 && bases_[base_of_.back()].mass > 0.0 && g.is_ball &&
                               g.center_B.isZero(0.0));
  }
}

// The step just made, from t [s] on and of this length [s], began at this configuration of the whole scene. In one step
// of the midpoint rule translations go along straight lines at constant speeds, and so does what flies alone between
// its impacts, but for the bow of its fall.
void Island::find_straight(const VecX& before, double t, double length) {
  forget_straight();
  if (!ok_ || bases_.empty() || !engine_->flew()) return;
  const bool once = engine_->flew_once();
  bow_ = once ? 0.0 : engine_->scene().tree.gravity.norm() * length * length / 8.0;
  const VecX& q = std::as_const(*engine_).state().q;
  for (Base& base : bases_) {
    const auto moved = [&](const VecX& now) {
      Vec3 x;
      for (int i = 0; i < 3; ++i) x[i] = now[base.iq + i] - before[numbers_->q[base.iq + i]];
      return Vec3(base.axes * x);
    };
    base.straight = once || (base.mass > 0.0 && tau_.size() == 0);
    base.along = moved(q);
    Vec3 from = Vec3::Zero();
    base.path = 0.0;
    for (const ImpactRecord& impact : recording_.impacts) {
      const auto [a, b] = guard_trees_[impact.guard];
      if (!base.straight || (a != base.tree && b != base.tree)) continue;
      base.straight = base.bends.size() < kMostBends;
      base.bends.push_back({std::clamp((impact.time - t) / length, 0.0, 1.0), moved(impact.q)});
      base.path += (base.bends.back().at - from).norm();
      from = base.bends.back().at;
    }
    base.path += (base.along - from).norm();
    if (base.turning < 0) continue;
    double turned = 0.0;
    for (int i = 0; i < 4; ++i) {
      const double change = q[base.turning + i] - before[numbers_->q[base.turning + i]];
      turned += change * change;
    }
    base.turn = 2.0 * std::sqrt(turned);
  }
}

int Island::local_guard(int guard) const { return position(numbers_->guards, guard); }

void Island::number_bodies(ContactPoint& point, bool into) const {
  for (int* body : {&point.point_body, &point.plane_body})
    if (*body >= 0 && point.kind != PointKind::kLimit)
      *body = into ? position(numbers_->joints, *body) : numbers_->joints[*body];
}

// Takes the entries of this island's guards out of a list.
template <class List, class GuardOf, class Put>
void Island::take(List& list, GuardOf guard_of, Put put) const {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const int guard = local_guard(guard_of(list[i]));
    if (guard >= 0) {
      put(list[i], guard);
    } else {
      list[kept++] = list[i];
    }
  }
  list.erase(list.begin() + static_cast<std::ptrdiff_t>(kept), list.end());
}

// Its part of a state of the whole scene.
void Island::take_state(const VecX& q, const VecX& p, Handover& to) const {
  to.q.resize(static_cast<Eigen::Index>(numbers_->q.size()));
  to.p.resize(static_cast<Eigen::Index>(numbers_->v.size()));
  for (std::size_t i = 0; i < numbers_->q.size(); ++i) to.q[static_cast<Eigen::Index>(i)] = q[numbers_->q[i]];
  for (std::size_t i = 0; i < numbers_->v.size(); ++i) to.p[static_cast<Eigen::Index>(i)] = p[numbers_->v[i]];
}

void Island::form(const VecX& q, const VecX& p, std::vector<LooseState>& loose, std::vector<JointFriction>& friction,
                  double t, double start_time) {
  Handover& to = handover_;
  take_state(q, p, to);
  to.control = loose[trees_[0]].control;
  to.largest_speed = 0.0;
  to.contact_steps = ContactStepsUntil();
  to.any = true;
  to.contacts.clear();
  to.touching.clear();
  to.exempt.clear();
  to.separated.clear();
  to.flights.clear();
  for (int tree : trees_) {
    LooseState& from = loose[tree];
    combine(from.control, to.control);
    to.largest_speed = std::max(to.largest_speed, from.largest_speed);
    if (from.contact_steps.time > to.contact_steps.time) to.contact_steps = from.contact_steps;
    take(
        from.contacts, [](const PersistentContact& c) { return c.point.guard; },
        [&](PersistentContact& c, int guard) {
          c.point.guard = guard;
          number_bodies(c.point, true);
          to.contacts.push_back(c);
        });
    const auto itself = [](int guard) { return guard; };
    take(from.touching, itself, [&](int, int guard) { to.touching.push_back(guard); });
    take(from.exempt, itself, [&](int, int guard) { to.exempt.push_back(guard); });
    take(
        from.separated, [](const SeparatedPoint& s) { return s.guard; },
        [&](const SeparatedPoint& s, int guard) { to.separated.push_back({guard, s.feature, s.left}); });
    take(
        from.flights, [](const Flights::Entry& f) { return f.first; },
        [&](const Flights::Entry& f, int guard) { to.flights.emplace_back(guard, f.second); });
  }
  take_dense(loose);
  to.joint_friction.clear();
  for (int k : numbers_->friction) to.joint_friction.push_back(friction[k]);
  engine_->take_over(to, fresh_, t, start_time);
  engine_->guards().begin_interval();
  rest_.steps = 0;
  passed_over_ = false;
  forget_straight();
}

// What dense steps carry: they go on where one of the trees had them.
void Island::take_dense(std::vector<LooseState>& loose) {
  Handover& to = handover_;
  DenseStep::Memory& step = to.dense_step;
  to.dense = loose[trees_[0]].dense;
  step.impulses.clear();
  step.closed.clear();
  step.change.resize(static_cast<Eigen::Index>(numbers_->v.size()));
  step.h = loose[trees_[0]].change_h;
  std::size_t known = 0;
  for (int tree : trees_) {
    LooseState& from = loose[tree];
    to.dense.active |= from.dense.active;
    to.dense.quiet = std::min(to.dense.quiet, from.dense.quiet);
    const double longest = from.dense.longest;
    if (longest > 0.0 && (to.dense.longest == 0.0 || longest < to.dense.longest)) to.dense.longest = longest;
    to.dense.wanted = std::max(to.dense.wanted, from.dense.wanted);
    to.dense.since_return = std::min(to.dense.since_return, from.dense.since_return);
    to.dense.located.join(from.dense.located);
    take(
        from.impulses, [](const DenseImpulse& i) { return i.guard; },
        [&](DenseImpulse impulse, int guard) {
          impulse.guard = guard;
          step.impulses.push_back(impulse);
        });
    take(from.closed, [](int guard) { return guard; }, [&](int, int guard) { step.closed.push_back(guard); });
    for (const auto& [dof, change] : from.change)
      if (from.change_h == step.h) {
        step.change[position(numbers_->v, dof)] = change;
        ++known;
      }
    from.change.clear();
  }
  if (known < numbers_->v.size()) step.change.resize(0);
}

void Island::file(const Handover& from, std::vector<LooseState>& loose, std::vector<JointFriction>& friction) const {
  const auto home = [&](int guard) -> LooseState& {
    const auto [a, b] = guard_trees_[guard];
    return loose[a < 0 ? b : b < 0 ? a : std::min(a, b)];
  };
  for (int tree : trees_) {
    loose[tree].control = from.control;
    loose[tree].largest_speed = from.largest_speed;
    loose[tree].contact_steps = from.contact_steps;
    loose[tree].dense = from.dense;
    loose[tree].change.clear();
    loose[tree].change_h = from.dense_step.h;
  }
  for (PersistentContact contact : from.contacts) {
    LooseState& to = home(contact.point.guard);
    contact.point.guard = numbers_->guards[contact.point.guard];
    number_bodies(contact.point, false);
    to.contacts.push_back(contact);
  }
  for (DenseImpulse impulse : from.dense_step.impulses) {
    LooseState& to = home(impulse.guard);
    impulse.guard = numbers_->guards[impulse.guard];
    to.impulses.push_back(impulse);
  }
  for (int g : from.dense_step.closed) home(g).closed.push_back(numbers_->guards[g]);
  const VecX& change = from.dense_step.change;
  for (Eigen::Index d = 0; d < change.size(); ++d) loose[dof_tree_[d]].change.emplace_back(numbers_->v[d], change[d]);
  for (int g : from.touching) home(g).touching.push_back(numbers_->guards[g]);
  for (int g : from.exempt) home(g).exempt.push_back(numbers_->guards[g]);
  for (const SeparatedPoint& s : from.separated)
    home(s.guard).separated.push_back({numbers_->guards[s.guard], s.feature, s.left});
  for (const Flights::Entry& f : from.flights) home(f.first).flights.emplace_back(numbers_->guards[f.first], f.second);
  for (std::size_t k = 0; k < from.joint_friction.size(); ++k) friction[numbers_->friction[k]] = from.joint_friction[k];
}

void Island::dissolve(std::vector<LooseState>& loose, std::vector<JointFriction>& friction) {
  engine_->hand_over(handover_);
  file(handover_, loose, friction);
}

void Island::undo(std::vector<LooseState>& loose, std::vector<JointFriction>& friction) {
  file(before_, loose, friction);
}

// Takes its part of the inputs; false: they are those of the step before.
bool Island::set_inputs(const VecX& tau, const VecX& q_ref, const VecX& v_ref) {
  const std::vector<int>& v = numbers_->v;
  const Eigen::Index nv = static_cast<Eigen::Index>(v.size()), given = tau.size() > 0 ? nv : 0;
  bool changed = tau_.size() != given;
  if (changed) tau_.resize(given);
  const auto put = [&changed](double& to, double value) {
    changed |= to != value;
    to = value;
  };
  for (Eigen::Index i = 0; i < given; ++i) put(tau_[i], tau[v[i]]);
  if (q_ref.size() > 0 && engine_->scene().tree.elements.servo_kp.size() > 0) {
    changed |= target_.size() == 0;
    target_.resize(1, 2 * nv);
    for (Eigen::Index i = 0; i < nv; ++i) {
      put(target_(0, i), q_ref[v[i]]);
      put(target_(0, nv + i), v_ref[v[i]]);
    }
  }
  return changed;
}

void Island::fall_asleep(long step, double length) {
  settled_ = step + 1;
  passed_over_ = true;
  engine_->state().dense.located = LocatedCost();
  mean_reactions_.resize(0);
  const WorkTally& done = engine_->state().work.tally();
  if (done.does_work && !numbers_->reactions.empty()) mean_reactions_ = done.reactions / length;
}

void Island::settle(long step) {
  DensePhase& dense = engine_->state().dense;
  if (!dense.active) dense.since_return += step - settled_;
  settled_ = step;
}

// before(i): the number i at the start of the step; most: how far points may have come, as kStill.
template <class Before>
void Rest::count_with(Before before, const double* now, const VecX& levers, bool quiet, double most) {
  const Eigen::Index size = levers.size();
  bool still = quiet && steps > 0;
  double moved = 0.0;
  for (Eigen::Index i = 0; i < size && still; ++i) {
    moved = std::max(moved, std::abs(now[i] - (steps > 1 ? q[i] : before(i))) * levers[i]);
    still = moved <= kMoves;
  }
  if (still && moved > most) {
    double largest = 1.0;
    for (Eigen::Index i = 0; i < size; ++i) largest = std::max(largest, std::abs(now[i]));
    still = moved <= most * largest;
  }
  if (!still) {
    steps = quiet ? 1 : 0;
    return;
  }
  if (steps == 1) {
    q.resize(size);
    for (Eigen::Index i = 0; i < size; ++i) q[i] = before(i);
  }
  ++steps;
}

void Rest::count(const VecX& before, const std::vector<int>& entries, const VecX& now, const VecX& levers, bool quiet,
                 bool dense) {
  count_with([&](Eigen::Index i) { return before[entries[i]]; }, now.data(), levers, quiet,
             dense ? kStillDense : kStill);
}

void Rest::count_undisturbed(const double* before, const double* now, const VecX& levers) {
  count_with([=](Eigen::Index i) { return before[i]; }, now, levers, true, kStill);
}

// Counts the step just made if it was one of rest: one step of the whole length with nothing but contacts that stay.
void Island::count_rest(const VecX& before) {
  bool quiet = ok_ && !depends_on_time_ && recording_.impacts.empty() && recording_.changes.empty();
  const std::vector<ContactRow>& rows = recording_.contacts;
  for (const ContactRow& row : rows) quiet = quiet && row.t == rows.front().t && row.mode != ContactMode::kSlips;
  const RunState& state = std::as_const(*engine_).state();
  rest_.count(before, numbers_->q, state.q, levers_, quiet, state.dense.active);
}

std::vector<double> Island::turns() const {
  std::vector<double> found;
  for (const Base& base : bases_) found.push_back(base.turn);
  return found;
}

void Island::restore_rest(const Rest& rest, const Recording& record, const VecX& mean_reactions, const VecX& tau,
                          const MatX& target, const std::vector<double>& turns, long step) {
  rest_ = rest;
  recording_ = record;
  mean_reactions_ = mean_reactions;
  tau_ = tau;
  target_ = target;
  forget_straight();
  for (std::size_t k = 0; k < bases_.size(); ++k) bases_[k].turn = turns[k];
  passed_over_ = asleep();
  settled_ = step;
}

void Island::step(const VecX& before, long step, double t, double length, const VecX& tau, const VecX& q_ref,
                  const VecX& v_ref, const Progress& progress) {
  if (set_inputs(tau, q_ref, v_ref)) rest_.steps = 0;
  if (own_) engine_->hand_over(before_);  // the island of all trees is never undone
  engine_->guards().begin_interval();
  recording_.clear();
  ok_ = engine_->step_island(step, t, length, tau_, target_, progress, recording_);
  find_straight(before, t, length);
  count_rest(before);
}

// While no interval may bring it near another one, and no step of it looks at guards, one number tells that.
void Island::measure(IslandGraph& graph) {
  const Guards& guards = engine_->guards();
  if (!graph.clear() || !(asleep() || guards.passed_all())) {
    for (std::size_t k = 0; k < offset_.size(); ++k) tell_motion_of(static_cast<int>(k), graph);
    return;
  }
  if (asleep()) return;
  find_share(graph);
  graph.count(guards.steps_since() * share_);
}

void Island::find_share(const IslandGraph& graph) {
  const Guards& guards = engine_->guards();
  if (share_span_ == guards.span() && share_room_ == graph.room_number()) return;
  share_ = 0.0;
  for (std::size_t k = 0; k < offset_.size(); ++k)
    share_ = std::max(share_, graph.part(numbers_->geometries[k], guards.motion_of_reference(static_cast<int>(k))));
  share_span_ = guards.span();
  share_room_ = graph.room_number();
}

void Island::tell_motion_of(int k, IslandGraph& graph) const {
  const int g = numbers_->geometries[k];
  graph.set_motion(g, motion(k));
  if (base_of_[k] < 0 || asleep()) return;
  const Base& base = bases_[base_of_[k]];
  if (base.straight)
    graph.paths().set(g, base.bends, base.along,
                      bow_ + (only_translates_[k] ? 0.0 : std::max(0.0, motion(k) - base.path)));
}

void Island::tell_expected(double length, IslandGraph& graph) const {
  const RunState& state = std::as_const(*engine_).state();
  if (asleep() || state.dense.active || !engine_->contact_step().contacts().empty()) return;
  const VecX& p = state.p;
  for (std::size_t k = 0; k < offset_.size(); ++k) {
    if (base_of_[k] < 0) continue;
    const Base& base = bases_[base_of_[k]];
    if (!(base.mass > 0.0)) continue;
    const int g = numbers_->geometries[k];
    const double turned = only_translates_[k] ? 0.0 : base.turn * engine_->scene().geometries[k].reach;
    graph.paths().foretell(g, base.axes * p.segment<3>(base.iv) * (length / base.mass), turned);
  }
}

void Island::tell_motion(IslandGraph& graph) const {
  for (std::size_t k = 0; k < offset_.size(); ++k) {
    const int own = static_cast<int>(k);
    graph.set_place(numbers_->geometries[k], offset_[k] + engine_->guards().odometer(own) - motion(own));
    tell_motion_of(own, graph);
  }
}

void Island::join_graph(const IslandGraph& graph) {
  for (std::size_t k = 0; k < offset_.size(); ++k)
    offset_[k] = graph.odometer(numbers_->geometries[k]) - engine_->guards().odometer(static_cast<int>(k));
}

void Island::gather_at(const VecX& q0, const VecX& p0, long step, double t, double part, const Progress& progress,
                       VecX& q, VecX& p) {
  if (!asleep() && part > 0.0) {
    const std::shared_ptr<const Snapshot> end = engine_->save();
    Recording unused;
    take_state(q0, p0, before_);
    engine_->take_over(before_, fresh_, t, t);
    const bool reached = engine_->step_island(step, t, part, tau_, target_, progress, unused);
    if (reached) gather(q, p);
    engine_->restore(*end);
    if (reached) return;
  }
  gather(q, p);
}

void Island::gather(VecX& q, VecX& p) const {
  const RunState& state = std::as_const(*engine_).state();
  for (std::size_t i = 0; i < numbers_->q.size(); ++i) q[numbers_->q[i]] = state.q[static_cast<Eigen::Index>(i)];
  for (std::size_t i = 0; i < numbers_->v.size(); ++i) p[numbers_->v[i]] = state.p[static_cast<Eigen::Index>(i)];
}

}  // namespace contactvi
