#include "sensitivity/held_slips.hpp"

namespace contactvi {

namespace {
constexpr double kAcross = 1e-6;  // of the speeds: a slip that is across its direction by more has turned back
}  // namespace

HeldSlips::HeldSlips(const Tree& tree, int stages)
    : raised_(stages), charts_(static_cast<std::size_t>(stages), NodeChart(tree)) {}

bool HeldSlips::take(const HeldStepRecord& s, std::vector<HeldNode>& nodes, const VecX& v0) {
  record_ = &s;
  nodes_ = &nodes;
  const Eigen::Index slides = nodes.front().along().cols();
  const auto stages = static_cast<int>(s.rates.cols());
  end_rate_ = nodes.back().chart().rate(s.v1);
  rates_ =
      s.rates * raised_.rate + v0 * raised_.rate_by_start.transpose() + end_rate_ * raised_.rate_by_end.transpose();
  X_ = s.h * (s.rates * raised_.moved + v0 * raised_.moved_by_start.transpose() +
              end_rate_ * raised_.moved_by_end.transpose());
  turned_by_.resize(static_cast<std::size_t>(stages));
  const Eigen::Index numbers = nodes.front().numbers();
  own_.setOnes(numbers, stages);
  by_t_.setZero(numbers, stages);
  MatX watched, along;
  const double speed = 1.0 + s.v1.cwiseAbs().maxCoeff();
  for (int k = 1; k < stages; ++k) {
    NodeChart& chart = charts_[static_cast<std::size_t>(k)];
    chart.take(X_.col(k - 1));
    const VecX v = chart.velocity(rates_.col(k - 1));
    nodes[static_cast<std::size_t>(k)].change_speeds(v, watched, along);
    turned_by_[static_cast<std::size_t>(k)] = watched.bottomRows(numbers);
    by_t_.col(k) = node(k).speed_rates(v).tail(numbers);
    own_.col(k).head(slides) = -node(k).slips(v);
    if (!(node(k).watched_slips(v).head(slides).cwiseAbs().maxCoeff() <= kAcross * speed)) return false;
  }
  return true;
}

VecX HeldSlips::change(int k, const MatX& du, const VecX& dv0, const VecX& dv1, const MatX& dX, const VecX& dq0,
                       double dh, double dt, const VecX& numbers) const {
  const double h = record_->h;
  const NodeChart& end = nodes_->back().chart();
  const VecX dX_end = dX.col(dX.cols() - 1), none = VecX::Zero(dq0.size());
  const VecX drate = end.rate(dv1 - end.velocity_change(end_rate_, none, dX_end));
  const VecX du_k =
      du * raised_.rate.col(k - 1) + raised_.rate_by_start[k - 1] * dv0 + raised_.rate_by_end[k - 1] * drate;
  VecX dX_k =
      h * (du * raised_.moved.col(k - 1) + raised_.moved_by_start[k - 1] * dv0 + raised_.moved_by_end[k - 1] * drate);
  dX_k += (dh / h) * X_.col(k - 1);
  const VecX dv = charts_[static_cast<std::size_t>(k)].velocity_change(rates_.col(k - 1), du_k, dX_k);
  const VecX dq = node(k).chart().turn(dX.col(k), dq0);
  return h * (watched(k) * dv + turned_by_[static_cast<std::size_t>(k)] * dq + by_t_.col(k) * dt +
              own_.col(k).cwiseProduct(numbers));
}

VecX HeldSlips::gradient(const VecX& rate_share, const VecX& moved_share, const VecX& l) const {
  const Eigen::Index n = rates_.rows(), numbers = own_.rows();
  VecX found = VecX::Zero(n);
  for (int k = 1; k < static_cast<int>(own_.cols()); ++k) {
    const VecX lv = record_->h * (watched(k).transpose() * l.segment((k - 1) * numbers, numbers));
    for (Eigen::Index c = 0; c < n; ++c) {
      const VecX unit = VecX::Unit(n, c);
      found[c] += lv.dot(charts_[static_cast<std::size_t>(k)].velocity_change(
          rates_.col(k - 1), rate_share[k - 1] * unit, (record_->h * moved_share[k - 1]) * unit));
    }
  }
  return found;
}

VecX HeldSlips::end_gradient(const VecX& l) const {
  return nodes_->back().chart().rate_transposed(gradient(raised_.rate_by_end, raised_.moved_by_end, l));
}

}  // namespace contactvi
