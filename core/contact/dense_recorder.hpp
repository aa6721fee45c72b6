// Keeps what the derivative of a dense step needs while the step is solved.
#pragma once

#include "contact/dense_rows.hpp"
#include "contact/dense_step_record.hpp"

namespace contactvi {

class DenseRecorder {
 public:
  DenseRecorder(const Scene& scene, Guards& guards) : scene_(&scene), guards_(&guards) {}

  // A step begins at the time t.
  void begin(const VecX& q0, const VecX& p0, double t, double h, bool keeps_energy);
  // The masses of the law.
  void take_masses(const BlockProblem& problem);
  // The law is about to be solved with the present candidates, from the motion v whose end q they are evaluated at. mu,
  // here and below: impulses of the constraints beside those of the problem.
  void start_pass(const std::vector<DenseContact>& contacts, const VecX& q, const VecX& v, const VecX& lambda,
                  const VecX& mu);
  // `lasting`: contacts of the pass whose slip is the mean of both ends.
  void set_lasting(const std::vector<int>& lasting);
  // The law was solved, with mu from the velocities that it started from; and then the gap iterations, which ended at
  // q.
  void take_law(const VecX& lambda, const VecX& mu, const VecX& v);
  void take_round(const std::vector<DenseContact>& contacts, const VecX& q, const VecX& v, const VecX& lambda,
                  const VecX& mu);
  // The position impulse; p: the momentum at the end, q1.
  void take_position(const VecX& lambda, const VecX& mu, const VecX& p);
  // Impulses at the end with the rows of the contacts `active`.
  void take_plastic(const std::vector<int>& active, const VecX& lambda, const VecX& mu, const VecX& v);
  void take_expansion(const std::vector<int>& active, const VecX& lambda, const VecX& mu, const VecX& v, double share);
  // The step is solved. The bodies are placed at its end afterwards.
  void finish(const std::vector<DenseContact>& contacts, const VecX& q1, const VecX& p1, const VecX& v1,
              double gap_solved);

  DenseStepRecord& record() { return record_; }

 private:
  void add_place(const std::vector<DenseContact>& contacts, const VecX& q, const VecX& v, const VecX& lambda);
  VecX ordered(const VecX& lambda, const VecX& mu) const;
  VecX spread(const std::vector<int>& active, const VecX& lambda) const;
  void keep_loaded(const std::vector<DenseContact>& contacts);

  const Scene* scene_;
  Guards* guards_;
  DenseStepRecord record_;
  std::vector<int> rows_of_, found_;  // of the candidates: rows; Contact::found
  std::size_t slips_ = 0;             // place of the pass
  bool anew_ = true;
  std::vector<int> active_of_end_;
  std::vector<char> lasting_;
};

}  // namespace contactvi
