#include "sensitivity/contact_step_numbers.hpp"

#include <cmath>
#include <type_traits>

#include "base/refusal.hpp"

namespace contactvi {

namespace {
constexpr double kWord = 4294967296.0;  // 2^32
constexpr double kLeastWhole = -2147483648.0, kMostWhole = 2147483647.0;

[[noreturn]] void refuse(const char* got) {
  throw Refusal("The recorded contact steps and impacts of the run do not belong to its scene",
                "those that the run has stored", got,
                "Choose a file of Trajectory.save; a damaged one has to be computed again");
}

class Writer {
 public:
  std::vector<double> numbers;

  void number(const double& x) { numbers.push_back(std::isfinite(x) ? x : 0.0); }
  template <class T>
  void whole(const T& x) {
    numbers.push_back(static_cast<double>(x));
  }
  void long_whole(const std::int64_t& x) {
    const auto bits = static_cast<std::uint64_t>(x);
    numbers.push_back(static_cast<double>(bits >> 32));
    numbers.push_back(static_cast<double>(bits & 0xffffffffu));
  }
  template <class Matrix>
  void fixed(const Matrix& x) {
    for (Eigen::Index k = 0; k < x.size(); ++k) number(x.data()[k]);
  }
  template <class Matrix>
  void sized(const Matrix& x) {
    whole(x.rows());
    whole(x.cols());
    fixed(x);
  }
  template <class T>
  void list_size(const std::vector<T>& list) {
    whole(list.size());
  }
};

class Reader {
 public:
  explicit Reader(const VecX& numbers) : at_(numbers.data()), end_(numbers.data() + numbers.size()) {}
  bool done() const { return at_ == end_; }

  void number(double& x) {
    if (at_ == end_) refuse("fewer numbers");
    x = *at_++;
    if (!std::isfinite(x)) refuse("numbers that are not finite");
  }
  template <class T>
  void whole(T& x) {
    double value;
    number(value);
    if (value != std::floor(value) || !(value >= kLeastWhole && value <= kMostWhole))
      refuse("a number that is not whole");
    if constexpr (std::is_same_v<T, bool>) {
      x = value != 0.0;
    } else {
      x = static_cast<T>(static_cast<int>(value));
    }
  }
  void long_whole(std::int64_t& x) {
    std::uint64_t bits = 0;
    for (int k = 0; k < 2; ++k) {
      double word;
      number(word);
      if (word != std::floor(word) || !(word >= 0.0 && word < kWord)) refuse("a number that is not whole");
      bits = bits << 32 | static_cast<std::uint64_t>(word);
    }
    x = static_cast<std::int64_t>(bits);
  }
  template <class Matrix>
  void fixed(Matrix& x) {
    for (Eigen::Index k = 0; k < x.size(); ++k) number(x.data()[k]);
  }
  template <class Matrix>
  void sized(Matrix& x) {
    int rows, columns;
    whole(rows);
    whole(columns);
    if (rows < 0 || columns < 0 || static_cast<double>(rows) * columns > static_cast<double>(end_ - at_))
      refuse("a matrix with fewer numbers");
    x.resize(rows, columns);
    fixed(x);
  }
  template <class T>
  void list_size(std::vector<T>& list) {
    int size;
    whole(size);
    if (size < 0 || size > end_ - at_) refuse("a list with fewer entries");
    list.resize(size);
  }

 private:
  const double *at_, *end_;
};

// All fields of a step, for writing and for reading.
template <class Archive, class Point>
void point_fields(Archive& a, Point& p) {
  a.whole(p.guard);
  a.whole(p.kind);
  a.long_whole(p.feature);
  a.whole(p.material);
  a.whole(p.on_b);
  a.whole(p.point_body);
  a.whole(p.plane_body);
  for (auto* x : {&p.radius, &p.offset, &p.rim_radius}) a.number(*x);
  for (auto* x : {&p.center_B, &p.normal_B, &p.axis_B, &p.far_B, &p.origin_B}) a.fixed(*x);
}

template <class Archive, class Place>
void contact_fields(Archive& a, Place& c) {
  a.number(c.gap);
  for (auto* x : {&c.normal, &c.point_a, &c.point_b}) a.fixed(*x);
  a.whole(c.body_a);
  a.whole(c.body_b);
}

template <class Archive, class Outcome>
void outcome_fields(Archive& a, Outcome& o) {
  contact_fields(a, o.contact);
  for (auto* x : {&o.t1, &o.t2, &o.position_impulse_W, &o.velocity_impulse_W, &o.position_impulse, &o.velocity_impulse,
                  &o.slip_W})
    a.fixed(*x);
  a.fixed(o.slip);
  for (auto* x : {&o.w_n, &o.reversed, &o.paradox, &o.friction_work}) a.number(*x);
  for (auto* x : {&o.slipped, &o.slips, &o.turned, &o.active, &o.keeps, &o.freed, &o.jumps}) a.whole(*x);
}

template <class Archive, class Persistent>
void persistent_fields(Archive& a, Persistent& c) {
  point_fields(a, c.point);
  a.number(c.mu);
  for (auto* x : {&c.sticks, &c.anchored, &c.is_new}) a.whole(*x);
  for (auto* x : {&c.slip, &c.anchor, &c.tangent, &c.force}) a.fixed(*x);
}

template <class Archive, class Kept>
void kept_fields(Archive& a, Kept& c) {
  persistent_fields(a, c.before);
  a.whole(c.by_rate);
  for (auto* x : {&c.t1_start, &c.t1_end}) a.fixed(*x);
  contact_fields(a, c.start);
  contact_fields(a, c.end);
  outcome_fields(a, c.outcome);
  a.whole(c.row);
}

template <class Archive, class Joint>
void joint_fields(Archive& a, Joint& j) {
  a.whole(j.dof);
  a.whole(j.iq);
  a.number(j.limit);
  for (auto* x : {&j.by_place, &j.anchored, &j.slipped, &j.slips, &j.keeps, &j.freed, &j.sticks}) a.whole(*x);
}

template <class Archive, class Step>
void step_fields(Archive& a, Step& s) {
  for (auto* x : {&s.t, &s.h, &s.nominal, &s.share}) a.number(*x);
  for (auto* x : {&s.q0, &s.p_start, &s.q1, &s.p_minus, &s.p1, &s.v, &s.v1, &s.lambda, &s.lambda_end}) a.sized(*x);
  a.sized(s.W0);
  a.sized(s.W1);
  a.whole(s.constrained);
  a.whole(s.ending);
  a.whole(s.ended);
  a.list_size(s.joints);
  for (auto& joint : s.joints) joint_fields(a, joint);
  a.list_size(s.contacts);
  for (auto& contact : s.contacts) kept_fields(a, contact);
}

// Of a contact, what laws beside Coulomb's with one number need.
template <class Archive, class Persistent>
void law_fields(Archive& a, Persistent& c) {
  a.number(c.pull_share);
  // Files of versions without adhesion of bodies have no number above 1 here.
  int kind = (c.by_velocity ? 1 : 0) + ((c.body_shares.array() == 1.0).all() ? 0 : 2);
  a.whole(kind);
  if constexpr (!std::is_const_v<Persistent>) c.by_velocity = kind % 2 == 1;
  if (kind >= 2) a.fixed(c.body_shares);
  for (auto* x : {&c.spinning, &c.rolling, &c.spin}) a.number(*x);
  a.fixed(c.roll);
}

template <class Archive, class Step>
void step_law_fields(Archive& a, Step& s) {
  for (auto& c : s.contacts) {
    law_fields(a, c.before);
    a.number(c.outcome.spin);
    for (auto* x :
         {&c.outcome.rolled, &c.outcome.rolls, &c.outcome.roll_turned, &c.outcome.roll_keeps, &c.outcome.roll_freed})
      a.whole(*x);
    a.fixed(c.outcome.turning_slip);
  }
}

template <class Archive, class Step>
void held_law_fields(Archive& a, Step& s) {
  for (auto& c : s.contacts) law_fields(a, c);
  a.sized(s.slips);
}

template <class Archive, class Block>
void block_fields(Archive& a, Block& b) {
  a.whole(b.impacts);
  a.whole(b.guard);
  a.number(b.time);
  a.number(b.impulse);
  a.list_size(b.members);
  for (auto& member : b.members) {
    a.whole(member.guard);
    a.number(member.e);
    a.list_size(member.points);
    for (auto& point : member.points) point_fields(a, point);
  }
}

template <class Archive, class Kept>
void dense_contact_fields(Archive& a, Kept& c) {
  point_fields(a, c.point);
  point_fields(a, c.law);
  for (auto* x : {&c.mu, &c.restitution, &c.allowed}) a.number(*x);
  contact_fields(a, c.start);
  contact_fields(a, c.end);
  for (auto* x : {&c.t1_start, &c.t1_end}) a.fixed(*x);
  // Files of versions that did not keep adhesion have no number above 1 here.
  int kind = (c.closed ? 1 : 0) + (c.knows_pull ? 2 : 0);
  a.whole(kind);
  if constexpr (!std::is_const_v<Kept>) {
    c.closed = kind % 2 == 1;
    c.knows_pull = kind >= 2;
  }
  a.whole(c.expands);
  for (auto* x : {&c.row, &c.found}) a.whole(*x);
  if (!c.knows_pull) return;
  a.fixed(c.pull);
  a.fixed(c.pull_rate);
}

template <class Archive, class Place>
void place_fields(Archive& a, Place& p) {
  for (auto* x : {&p.q, &p.v, &p.lambda}) a.sized(*x);
  a.list_size(p.end);
  for (auto& contact : p.end) contact_fields(a, contact);
  a.list_size(p.t1);
  for (auto& t1 : p.t1) a.fixed(t1);
  a.sized(p.W);
}

template <class Archive, class Round>
void round_fields(Archive& a, Round& r) {
  a.whole(r.about);
  a.whole(r.anew);
  a.whole(r.slips);
  for (auto* flags : {&r.present, &r.lasting}) {
    a.list_size(*flags);
    for (auto& flag : *flags) a.whole(flag);
  }
  for (auto* x : {&r.lambda, &r.v}) a.sized(*x);
}

template <class Archive, class Step>
void dense_fields(Archive& a, Step& s) {
  for (auto* x : {&s.t, &s.h, &s.share, &s.allowed_rate}) a.number(*x);
  for (auto* x : {&s.q0, &s.p0}) a.sized(*x);
  a.list_size(s.joints);
  for (auto& joint : s.joints) {
    a.whole(joint.dof);
    a.number(joint.limit);
  }
  a.list_size(s.contacts);
  for (auto& contact : s.contacts) dense_contact_fields(a, contact);
  for (auto* x : {&s.W0, &s.W1, &s.D}) a.sized(*x);
  a.list_size(s.places);
  for (auto& place : s.places) place_fields(a, place);
  a.list_size(s.rounds);
  for (auto& round : s.rounds) round_fields(a, round);
  for (auto* x : {&s.lambda, &s.p_minus, &s.p1, &s.plastic, &s.v_plastic, &s.expansion, &s.v_expansion, &s.v1})
    a.sized(*x);
  for (auto* x : {&s.expanded, &s.gap_solved, &s.residual}) a.number(*x);
  a.whole(s.repaired);
  a.whole(s.keeps_energy);
}

template <class Archive, class Joint>
void friction_joint_fields(Archive& a, Joint& j) {
  a.whole(j.dof);
  a.whole(j.iq);
  for (auto* x : {&j.limit, &j.heading}) a.number(*x);
  a.whole(j.sticks);
}

template <class Archive, class Step>
void held_fields(Archive& a, Step& s) {
  for (auto* x : {&s.t, &s.h}) a.number(*x);
  for (auto* x : {&s.q0, &s.p0, &s.v1}) a.sized(*x);
  for (auto* x : {&s.rates, &s.lambda, &s.angles}) a.sized(*x);
  a.list_size(s.contacts);
  for (auto& c : s.contacts) persistent_fields(a, c);
  a.list_size(s.joints);
  for (auto& joint : s.joints) friction_joint_fields(a, joint);
  a.whole(s.ending);
  a.whole(s.ended);
}

bool within(int k, std::size_t count) { return k >= 0 && static_cast<std::size_t>(k) < count; }
bool is_body(const Scene& scene, int k) { return k == -1 || within(k, scene.tree.joints.size()); }

// Whether it is a point of one of the scene's guards.
bool belongs(const Scene& scene, const ContactPoint& p) {
  if (!within(p.guard, scene.guard_count()) || p.kind > PointKind::kSolids) return false;
  if ((p.kind == PointKind::kLimit) == scene.is_pair(p.guard)) return false;
  return p.kind == PointKind::kLimit || (is_body(scene, p.point_body) && is_body(scene, p.plane_body));
}

// Whether a contact has the laws of its pair.
bool has_laws(const Scene& scene, const PersistentContact& c) {
  if (!belongs(scene, c.point) || !(c.mu >= 0.0) || !(c.pull_share >= 0.0 && c.pull_share <= 1.0)) return false;
  if (!(c.body_shares.minCoeff() >= 0.0 && c.body_shares.maxCoeff() <= 1.0)) return false;
  const ContactLaw* law = scene.law(c.point.guard);
  const double spinning = law != nullptr ? law->spinning : 0.0, rolling = law != nullptr ? law->rolling : 0.0;
  return c.spinning == spinning && c.rolling == rolling;
}

bool belongs(const Scene& scene, const ImpactBlockRecord& block) {
  if (block.impacts < 1 || !within(block.guard, scene.guard_count())) return false;
  for (const ImpactBlockRecord::Member& member : block.members) {
    if (!within(member.guard, scene.guard_count()) || !(member.e >= 0.0 && member.e <= 1.0)) return false;
    for (const ContactPoint& point : member.points)
      if (point.guard != member.guard || !belongs(scene, point)) return false;
  }
  return true;
}

// Whether all numbers of places are those of places in the scene and in the step.
class Check {
 public:
  Check(const Scene& scene, const ContactStepRecord& step) : scene_(scene), s_(step) {}

  bool fits() const {
    const int nq = scene_.tree.nq, nv = scene_.tree.nv;
    const Eigen::Index rows = s_.lambda.size();
    bool good = s_.h > 0.0 && s_.nominal > 0.0 && s_.q0.size() == nq && s_.q1.size() == nq;
    for (const VecX* x : {&s_.p_start, &s_.p_minus, &s_.p1, &s_.v, &s_.v1}) good &= x->size() == nv;
    for (const MatX* W : {&s_.W0, &s_.W1}) good &= W->rows() == nv && W->cols() == rows;
    good &= s_.constrained == (constraints() > 0);
    return good && s_.lambda_end.size() == rows && joints_fit(rows) && contacts_fit(rows) && end_fits();
  }

 private:
  int constraints() const { return scene_.tree.elements.constraint_rows; }
  bool joints_fit(Eigen::Index rows) const {
    if (constraints() + static_cast<Eigen::Index>(s_.joints.size()) > rows) return false;
    for (const ContactStepRecord::Joint& joint : s_.joints)
      if (!within(joint.dof, scene_.tree.nv) || !(joint.iq == -1 || within(joint.iq, scene_.tree.nq))) return false;
    return true;
  }
  bool contacts_fit(Eigen::Index rows) const {
    for (const ContactStepRecord::Contact& c : s_.contacts) {
      const ContactPoint& p = c.before.point;
      if (!belongs(scene_, p) || !(s_.lacks_laws || has_laws(scene_, c.before))) return false;
      const bool limit = p.kind == PointKind::kLimit;
      if (limit && c.before.mu > 0.0) return false;
      for (int body : {c.start.body_a, c.start.body_b, c.end.body_a, c.end.body_b})
        if (!limit && !is_body(scene_, body)) return false;
      if (c.row < constraints() || c.row + c.before.rows() > rows || c.before.mu < 0.0) return false;
    }
    return true;
  }
  bool end_fits() const {
    const std::size_t contacts = s_.contacts.size();
    switch (s_.ending) {
      case ContactStepEnd::kLength:
      case ContactStepEnd::kImpact:
        return true;
      case ContactStepEnd::kRelease:
        return within(s_.ended, contacts);
      case ContactStepEnd::kStick: {
        const std::size_t others = contacts + s_.joints.size();
        if (within(s_.ended, others))
          return static_cast<std::size_t>(s_.ended) >= contacts || s_.contacts[s_.ended].before.mu > 0.0;
        return within(s_.ended, others + contacts) && s_.contacts[s_.ended - others].before.rows() > 4;
      }
    }
    return false;
  }

  const Scene& scene_;
  const ContactStepRecord& s_;
};
// Whether all numbers of places are those of places in the scene and in the dense step.
class DenseCheck {
 public:
  DenseCheck(const Scene& scene, const DenseStepRecord& step) : scene_(scene), s_(step) {}

  bool fits() const {
    const int nq = scene_.tree.nq, nv = scene_.tree.nv;
    const Eigen::Index rows = s_.lambda.size();
    bool good = s_.h > 0.0 && s_.q0.size() == nq && s_.D.rows() == nv && s_.D.cols() == nv && s_.plastic.size() == rows;
    for (const VecX* x : {&s_.p0, &s_.p_minus, &s_.p1, &s_.v_plastic, &s_.v_expansion, &s_.v1}) good &= x->size() == nv;
    for (const MatX* W : {&s_.W0, &s_.W1}) good &= is_rows(*W, rows);
    good = good && (s_.expansion.size() == 0 || s_.expansion.size() == rows);
    return good && joints_fit(rows) && contacts_fit(rows) && places_fit(rows) && rounds_fit(rows);
  }

 private:
  bool is_rows(const MatX& W, Eigen::Index rows) const { return W.rows() == scene_.tree.nv && W.cols() == rows; }
  bool is_place(int k) const { return within(k, s_.places.size()); }
  bool is_contact(const Contact& c) const { return is_body(scene_, c.body_a) && is_body(scene_, c.body_b); }

  bool joints_fit(Eigen::Index rows) const {
    if (s_.row_of(s_.joints.size()) > rows) return false;
    for (const DenseStepRecord::Joint& joint : s_.joints)
      if (!within(joint.dof, scene_.tree.nv)) return false;
    return true;
  }
  bool contacts_fit(Eigen::Index rows) const {
    for (const DenseStepRecord::Contact& c : s_.contacts) {
      if (!belongs(scene_, c.point) || !belongs(scene_, c.law) || c.point.guard != c.law.guard) return false;
      const bool limit = c.point.kind == PointKind::kLimit;
      if ((limit && c.mu > 0.0) || !(c.mu >= 0.0) || !(c.found == -1 || is_place(c.found))) return false;
      if (!limit && !(is_contact(c.start) && is_contact(c.end))) return false;
      if (c.row < s_.row_of(s_.joints.size()) || c.row + (c.mu > 0.0 ? 3 : 1) > rows) return false;
    }
    return true;
  }
  bool places_fit(Eigen::Index rows) const {
    for (const DenseStepRecord::Place& p : s_.places) {
      if (p.q.size() != scene_.tree.nq || p.v.size() != scene_.tree.nv || p.lambda.size() != rows) return false;
      if (p.end.size() != s_.contacts.size() || p.t1.size() != s_.contacts.size() || !is_rows(p.W, rows)) return false;
      for (std::size_t i = 0; i < p.end.size(); ++i)
        if (s_.contacts[i].point.kind != PointKind::kLimit && !is_contact(p.end[i])) return false;
    }
    return true;
  }
  // Every round starts from an earlier place and leads to the next one.
  bool rounds_fit(Eigen::Index rows) const {
    if (s_.places.size() != s_.rounds.size() + 1 || s_.rounds.empty()) return false;
    for (std::size_t k = 0; k < s_.rounds.size(); ++k) {
      const DenseStepRecord::Round& r = s_.rounds[k];
      if (r.about != static_cast<int>(k) || r.slips < 0 || r.slips > r.about) return false;
      if (r.present.size() != s_.contacts.size() || r.lasting.size() != s_.contacts.size()) return false;
      if (r.lambda.size() != rows || r.v.size() != scene_.tree.nv) return false;
      for (std::size_t i = 0; i < r.lasting.size(); ++i)
        if (r.lasting[i] != 0 && !(s_.contacts[i].mu > 0.0)) return false;
    }
    return true;
  }

  const Scene& scene_;
  const DenseStepRecord& s_;
};

// Whether what ended the step did before it what ends there.
bool end_fits(const HeldStepRecord& s) {
  const std::size_t contacts = s.contacts.size();
  if (s.ending == HeldStepEnd::kGiven) return s.ended == -1;
  if (!within(s.ended, contacts + s.joints.size())) return false;
  const auto number = static_cast<std::size_t>(s.ended);
  if (number >= contacts) {
    const bool slips = s.ending == HeldStepEnd::kSlip, rests = s.ending == HeldStepEnd::kRest;
    return s.joints[number - contacts].sticks ? slips : rests;
  }
  const PersistentContact& c = s.contacts[number];
  if (s.ending == HeldStepEnd::kRest) return c.slides();
  return s.ending == HeldStepEnd::kRelease || s.ending == HeldStepEnd::kBorder ||
         (s.ending == HeldStepEnd::kSlip && c.mu > 0.0 && c.sticks);
}

bool belongs(const Scene& scene, const HeldStepRecord& s) {
  const Tree& tree = scene.tree;
  const Eigen::Index stages = s.rates.cols();
  Eigen::Index rows = tree.elements.constraint_rows, slides = 0;
  for (const PersistentContact& c : s.contacts) {
    if (!belongs(scene, c.point) || !(c.mu >= 0.0) || !(s.lacks_laws || has_laws(scene, c))) return false;
    if (c.keeps_place() && c.point.kind != PointKind::kVertex) return false;
    rows += c.slides() ? 1 : c.rows();
    slides += c.slides() ? 1 : 0;
  }
  for (const FrictionJoint& joint : s.joints) {
    if (!within(joint.dof, static_cast<std::size_t>(tree.nv)) || joint.iq < -1 || joint.iq >= tree.nq) return false;
    if (!(joint.limit >= 0.0)) return false;
    rows += joint.sticks ? 1 : 0;
  }
  if (!end_fits(s)) return false;
  if (!s.lacks_laws && (s.slips.rows() != s.angles.rows() || s.slips.cols() != s.angles.cols())) return false;
  return s.h > 0.0 && s.q0.size() == tree.nq && s.p0.size() == tree.nv && s.v1.size() == tree.nv &&
         s.rates.rows() == tree.nv && stages >= 1 && stages <= kMaxStages && s.lambda.cols() == stages + 1 &&
         s.lambda.rows() == rows && s.angles.rows() == slides && (slides == 0 || s.angles.cols() == stages + 1);
}
}  // namespace

std::vector<double> numbers_of(const std::vector<ContactStepRecord>& steps) {
  Writer writer;
  for (const ContactStepRecord& step : steps) step_fields(writer, step);
  return std::move(writer.numbers);
}

std::vector<double> law_numbers_of(const std::vector<ContactStepRecord>& steps) {
  Writer writer;
  for (const ContactStepRecord& step : steps) step_law_fields(writer, step);
  return std::move(writer.numbers);
}

std::vector<ContactStepRecord> contact_steps_of(const Scene& scene, const VecX& numbers, const VecX& laws) {
  Reader reader(numbers), law_reader(laws);
  std::vector<ContactStepRecord> steps;
  while (!reader.done()) {
    step_fields(reader, steps.emplace_back());
    steps.back().lacks_laws = laws.size() == 0;
    if (laws.size() > 0) step_law_fields(law_reader, steps.back());
    if (!Check(scene, steps.back()).fits()) refuse("numbers of another scene");
  }
  if (!law_reader.done()) refuse("laws of more contacts");
  return steps;
}

std::vector<double> numbers_of(const std::vector<ImpactBlockRecord>& blocks) {
  Writer writer;
  for (const ImpactBlockRecord& block : blocks) block_fields(writer, block);
  return std::move(writer.numbers);
}

std::vector<ImpactBlockRecord> impact_blocks_of(const Scene& scene, const VecX& numbers) {
  Reader reader(numbers);
  std::vector<ImpactBlockRecord> blocks;
  while (!reader.done()) {
    block_fields(reader, blocks.emplace_back());
    if (!belongs(scene, blocks.back())) refuse("numbers of another scene");
  }
  return blocks;
}

std::vector<double> numbers_of(const std::vector<DenseStepRecord>& steps) {
  Writer writer;
  for (const DenseStepRecord& step : steps) dense_fields(writer, step);
  return std::move(writer.numbers);
}

std::vector<DenseStepRecord> dense_steps_of(const Scene& scene, const VecX& numbers) {
  Reader reader(numbers);
  std::vector<DenseStepRecord> steps;
  while (!reader.done()) {
    dense_fields(reader, steps.emplace_back());
    steps.back().constraints = scene.tree.elements.constraint_rows;
    if (!DenseCheck(scene, steps.back()).fits()) refuse("numbers of another scene");
  }
  return steps;
}

std::vector<double> numbers_of(const std::vector<HeldStepRecord>& steps) {
  Writer writer;
  for (const HeldStepRecord& step : steps) held_fields(writer, step);
  return std::move(writer.numbers);
}

std::vector<double> law_numbers_of(const std::vector<HeldStepRecord>& steps) {
  Writer writer;
  for (const HeldStepRecord& step : steps) held_law_fields(writer, step);
  return std::move(writer.numbers);
}

std::vector<HeldStepRecord> held_steps_of(const Scene& scene, const VecX& numbers, const VecX& laws) {
  Reader reader(numbers), law_reader(laws);
  std::vector<HeldStepRecord> steps;
  while (!reader.done()) {
    held_fields(reader, steps.emplace_back());
    steps.back().lacks_laws = laws.size() == 0;
    if (laws.size() > 0) held_law_fields(law_reader, steps.back());
    if (!belongs(scene, steps.back())) refuse("numbers of another scene");
  }
  if (!law_reader.done()) refuse("laws of more contacts");
  return steps;
}

}  // namespace contactvi
