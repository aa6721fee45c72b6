#include "step/stage_response.hpp"

#include <algorithm>

namespace contactvi {

bool StageResponse::take(const StepSolution& step) {
  h_ = step.h;
  take_stages(step);
  return factor();
}

void StageResponse::solve(const StagePanel& given, StagePanel& rates) {
  const int s = blocks_.size(), count = static_cast<int>(given.cols()), width = padded_width(count);
  rates.resize(given.rows(), count);
  for (int c = 0; c < components(); ++c) {
    const std::vector<int>& dofs = pattern_.components()[c];
    panel_ = AlignedArray(dofs.size() * s * width);
    std::fill_n(panel_.data(), dofs.size() * s * width, 0.0);
    for (const int d : dofs)
      for (int i = 0; i < s; ++i) std::copy_n(given.row(d * s + i).data(), count, row(panel_.data(), d, i, width));
    fold_rows(panel_.data(), s, width);
    blocks_.solve(c, panel_.data(), width);
    follow_rows(panel_.data(), s, width);
    for (const int d : dofs)
      for (int i = 0; i < s; ++i) std::copy_n(row(panel_.data(), d, i, width), count, rates.row(d * s + i).data());
  }
}

// On spherical joints dv = J du + E dX, dX = h A du.
void StageResponse::velocities(const StagePanel& rates, StagePanel& found) const {
  const int s = blocks_.size();
  const GaussTable& table = stages_.table();
  found = rates;
  for (std::size_t b = 0; b < balls_.size(); ++b) {
    const int iv = balls_[b].iv;
    for (int i = 0; i < s; ++i) {
      const BallChart& chart = stages_.chart(static_cast<int>(b), i);
      for (Eigen::Index c = 0; c < rates.cols(); ++c) {
        Vec3 u, X = Vec3::Zero();
        for (int r = 0; r < 3; ++r) {
          u[r] = rates((iv + r) * s + i, c);
          for (int j = 0; j < s; ++j) X[r] += h_ * table.A[i][j] * rates((iv + r) * s + j, c);
        }
        const Vec3 v = chart.J * u + chart.E * X;
        for (int r = 0; r < 3; ++r) found((iv + r) * s + i, c) = v[r];
      }
    }
  }
}

void StageResponse::end_momenta(const StagePanel& rates, StagePanel& momenta) {
  const int s = blocks_.size(), count = static_cast<int>(rates.cols()), width = padded_width(count);
  for (int c = 0; c < components(); ++c) {
    const std::vector<int>& dofs = pattern_.components()[c];
    panel_ = AlignedArray(dofs.size() * s * width);
    moved_ = AlignedArray(dofs.size() * width);
    total_ = AlignedArray(dofs.size() * width);
    const auto in_total = [&](int d) { return total_.data() + static_cast<std::size_t>(pattern_.place(d)) * width; };
    std::fill_n(panel_.data(), dofs.size() * s * width, 0.0);
    std::fill_n(total_.data(), dofs.size() * width, 0.0);
    for (const int d : dofs) {
      for (int i = 0; i < s; ++i) std::copy_n(rates.row(d * s + i).data(), count, row(panel_.data(), d, i, width));
      std::copy_n(momenta.row(d).data(), count, in_total(d));
    }
    sum_ends(c, panel_.data(), width, moved_.data(), total_.data());
    turn_ends(c, width, moved_.data(), total_.data());
    for (const int d : dofs) std::copy_n(in_total(d), count, momenta.row(d).data());
  }
}

}  // namespace contactvi
