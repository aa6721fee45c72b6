#include "contact/dense_recorder.hpp"

#include <algorithm>

#include "model/constraints.hpp"
#include "model/coupling.hpp"

namespace contactvi {

namespace {

// The chosen rows of a vector, or columns of a matrix, that may lack the last of them.
VecX chosen(const VecX& x, const std::vector<int>& rows) {
  VecX found = VecX::Zero(static_cast<Eigen::Index>(rows.size()));
  for (std::size_t k = 0; k < rows.size(); ++k)
    if (rows[k] < x.size()) found[static_cast<Eigen::Index>(k)] = x[rows[k]];
  return found;
}

bool any(const VecX& x, int row, int count) {
  for (int r = row; r < std::min<int>(row + count, static_cast<int>(x.size())); ++r)
    if (x[r] != 0.0) return true;
  return false;
}

}  // namespace

void DenseRecorder::begin(const VecX& q0, const VecX& p0, double t, double h, bool keeps_energy) {
  record_ = DenseStepRecord();
  found_.clear();
  record_.t = t;
  record_.h = h;
  record_.q0 = q0;
  record_.p0 = p0;
  record_.expanded = 1.0;
  record_.keeps_energy = keeps_energy;
  const Elements& e = scene_->tree.elements;
  record_.constraints = e.constraint_rows;
  for (int dof : e.friction_dofs) record_.joints.push_back({dof, e.joint_friction[dof]});
}

void DenseRecorder::take_masses(const BlockProblem& problem) {
  record_.D.setZero(scene_->tree.nv, scene_->tree.nv);
  for (int b = 0; b < problem.blocks(); ++b)
    record_.D.block(problem.start[b], problem.start[b], problem.size(b), problem.size(b)) = problem.M[b];
}

// From the order of the contact problem, which has no rows of constraints and those of the joints last.
VecX DenseRecorder::ordered(const VecX& lambda, const VecX& mu) const {
  const auto joints = static_cast<Eigen::Index>(record_.joints.size());
  VecX found(mu.size() + lambda.size());
  found << mu, lambda.tail(joints), lambda.head(lambda.size() - joints);
  return found;
}

// In the order of the record, from the rows of the contacts `active` in that order.
VecX DenseRecorder::spread(const std::vector<int>& active, const VecX& lambda) const {
  const Eigen::Index others = record_.row_of(record_.joints.size());
  VecX found = VecX::Zero(record_.lambda.size());
  found.head(others) = lambda.head(others);
  std::vector<Eigen::Index> first(rows_of_.size() + 1, others);
  for (std::size_t i = 0; i < rows_of_.size(); ++i) first[i + 1] = first[i] + rows_of_[i];
  Eigen::Index row = others;
  for (int i : active) {
    found.segment(first[i], rows_of_[i]) = lambda.segment(row, rows_of_[i]);
    row += rows_of_[i];
  }
  return found;
}

void DenseRecorder::add_place(const std::vector<DenseContact>& contacts, const VecX& q, const VecX& v,
                              const VecX& lambda) {
  DenseStepRecord::Place place;
  place.q = q;
  place.v = v;
  place.lambda = lambda;
  for (const DenseContact& c : contacts) {
    place.end.push_back(c.at1);
    const bool pair = scene_->is_pair(c.point.guard);
    place.t1.push_back(pair ? carried_tangent(c.t1_0, c.at0.normal, c.at1.normal) : Vec3(Vec3::Zero()));
  }
  record_.places.push_back(std::move(place));
}

void DenseRecorder::start_pass(const std::vector<DenseContact>& contacts, const VecX& q, const VecX& v,
                               const VecX& lambda, const VecX& mu) {
  if (record_.rounds.empty()) {
    add_place(contacts, q, v, ordered(lambda, mu));
  } else {
    // The last place again, with the points that have joined.
    DenseStepRecord::Place& last = record_.places.back();
    for (std::size_t i = last.end.size(); i < contacts.size(); ++i) {
      const DenseContact& c = contacts[i];
      last.end.push_back(c.at1);
      const bool pair = scene_->is_pair(c.point.guard);
      last.t1.push_back(pair ? carried_tangent(c.t1_0, c.at0.normal, c.at1.normal) : Vec3(Vec3::Zero()));
    }
  }
  slips_ = record_.places.size() - 1;
  for (std::size_t i = found_.size(); i < contacts.size(); ++i)
    found_.push_back(contacts[i].joined ? static_cast<int>(slips_) : -1);
  anew_ = true;
  lasting_.assign(contacts.size(), 0);
}

void DenseRecorder::set_lasting(const std::vector<int>& lasting) {
  for (int i : lasting) lasting_[i] = 1;
}

void DenseRecorder::take_law(const VecX& lambda, const VecX& mu, const VecX& v) {
  const int about = static_cast<int>(record_.places.size()) - 1;
  VecX all = ordered(lambda, mu);
  if (!anew_) all.head(mu.size()) += record_.places.back().lambda.head(mu.size());
  record_.rounds.push_back(
      {about, anew_, static_cast<int>(slips_), std::vector<char>(lasting_.size(), 1), lasting_, std::move(all), v});
  anew_ = false;
}

void DenseRecorder::take_round(const std::vector<DenseContact>& contacts, const VecX& q, const VecX& v,
                               const VecX& lambda, const VecX& mu) {
  add_place(contacts, q, v, ordered(lambda, mu));
}

void DenseRecorder::take_position(const VecX& lambda, const VecX& mu, const VecX& p) {
  record_.lambda = ordered(lambda, mu);
  record_.p_minus = p;
}

void DenseRecorder::take_plastic(const std::vector<int>& active, const VecX& lambda, const VecX& mu, const VecX& v) {
  record_.plastic = ordered(lambda, mu);
  record_.v_plastic = v;
  record_.v_expansion = v;
  active_of_end_ = active;
}

void DenseRecorder::take_expansion(const std::vector<int>& active, const VecX& lambda, const VecX& mu, const VecX& v,
                                   double share) {
  record_.expansion = ordered(lambda, mu);
  record_.v_expansion = v;
  record_.expanded = share;
  active_of_end_ = active;
}

// The contacts with an impulse, and their rows.
void DenseRecorder::keep_loaded(const std::vector<DenseContact>& contacts) {
  DenseStepRecord& s = record_;
  rows_of_.clear();
  for (const DenseContact& c : contacts) rows_of_.push_back(c.rows());
  s.plastic = spread(active_of_end_, s.plastic);
  if (s.expansion.size() > 0) s.expansion = spread(active_of_end_, s.expansion);
  std::vector<int> rows, kept;
  int row = static_cast<int>(s.row_of(s.joints.size()));
  for (int k = 0; k < row; ++k) rows.push_back(k);
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const DenseContact& c = contacts[i];
    bool loaded = c.pull.sum() > 0.0 || any(s.lambda, row, c.rows()) || any(s.plastic, row, c.rows()) ||
                  any(s.expansion, row, c.rows());
    for (const DenseStepRecord::Round& round : s.rounds) loaded |= any(round.lambda, row, c.rows());
    for (const DenseStepRecord::Place& place : s.places) loaded |= any(place.lambda, row, c.rows());
    if (loaded) {
      const Vec3 t1 = scene_->is_pair(c.point.guard) ? c.t1_1 : Vec3(Vec3::Zero());
      s.contacts.push_back({c.point, c.law, c.mu, c.restitution, c.allowed, c.at0, c.at1, c.t1_0, t1, c.closed,
                            c.expands, static_cast<int>(rows.size()), found_[i], true, c.pull, c.pull_rate});
      kept.push_back(static_cast<int>(i));
      for (int r = 0; r < c.rows(); ++r) rows.push_back(row + r);
    }
    row += c.rows();
  }
  for (VecX* x : {&s.lambda, &s.plastic}) *x = chosen(*x, rows);
  if (s.expansion.size() > 0) s.expansion = chosen(s.expansion, rows);
  for (DenseStepRecord::Round& round : s.rounds) {
    round.lambda = chosen(round.lambda, rows);
    for (std::vector<char>* flags : {&round.present, &round.lasting}) {
      std::vector<char> found;
      for (int i : kept) found.push_back(static_cast<std::size_t>(i) < flags->size() ? (*flags)[i] : 0);
      *flags = found;
    }
  }
  for (DenseStepRecord::Place& place : s.places) {
    place.lambda = chosen(place.lambda, rows);
    std::vector<Contact> end;
    std::vector<Vec3> t1;
    for (int i : kept) {
      const bool known = static_cast<std::size_t>(i) < place.end.size();
      end.push_back(known ? place.end[i] : contacts[i].at1);
      t1.push_back(known ? place.t1[i] : contacts[i].t1_1);
    }
    place.end = end;
    place.t1 = t1;
  }
}

void DenseRecorder::finish(const std::vector<DenseContact>& contacts, const VecX& q1, const VecX& p1, const VecX& v1,
                           double gap_solved) {
  DenseStepRecord& s = record_;
  keep_loaded(contacts);
  s.p1 = p1;
  s.v1 = v1;
  s.gap_solved = gap_solved;
  VecX phi(s.constraints), rate(s.constraints);
  const auto fill = [&](const VecX& q, const auto& contact_at, const auto& tangent_at, MatX& W) {
    guards_->place(q);
    W.setZero(scene_->tree.nv, s.lambda.size());
    // The time has no effect on the rows.
    if (s.constraints > 0)
      evaluate_constraints(scene_->tree, guards_->placements(), q, s.t, phi, W.leftCols(s.constraints), rate);
    for (std::size_t k = 0; k < s.joints.size(); ++k) W(s.joints[k].dof, s.row_of(k)) = 1.0;
    for (std::size_t i = 0; i < s.contacts.size(); ++i) {
      const DenseStepRecord::Contact& c = s.contacts[i];
      guards_->rows(c.point.guard, contact_at(i), tangent_at(i), W.middleCols(c.row, c.mu > 0.0 ? 3 : 1));
    }
    project_rows(scene_->tree, W);  // as those of the contact problem (dense_rows.hpp)
  };
  for (DenseStepRecord::Place& place : s.places) {
    guards_->place(place.q);
    for (std::size_t i = 0; i < s.contacts.size(); ++i)
      if (const int guard = s.contacts[i].point.guard; guards_->has_axis(guard))
        place.t1[i] = guards_->tangent(guard, place.end[i].normal);
    fill(place.q, [&](std::size_t i) { return place.end[i]; }, [&](std::size_t i) { return place.t1[i]; }, place.W);
  }
  fill(
      s.q0, [&](std::size_t i) { return s.contacts[i].start; }, [&](std::size_t i) { return s.contacts[i].t1_start; },
      s.W0);
  fill(q1, [&](std::size_t i) { return s.contacts[i].end; }, [&](std::size_t i) { return s.contacts[i].t1_end; }, s.W1);
}

}  // namespace contactvi
