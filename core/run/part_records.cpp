#include "run/part_records.hpp"

namespace contactvi {

void append_contact(const SubScene& part, const ContactRows& from, std::size_t row, ContactRows& to) {
  const auto three = [row](const std::vector<double>& list) {
    return Vec3(list[3 * row], list[3 * row + 1], list[3 * row + 2]);
  };
  to.push(from.t[row], from.h[row], part.guards[from.guard[row]], from.point[row],
          static_cast<ContactMode>(from.mode[row]), from.step[row], three(from.position), three(from.normal),
          three(from.position_impulse), three(from.velocity_impulse), from.gap[row], three(from.slip), from.work[row]);
  to.dense.back() = from.dense[row];
}

void append_change(const SubScene& part, ChangeRecord change, std::vector<ChangeRecord>& to) {
  change.guard = part.guards[change.guard];
  to.push_back(change);
}

void append_dense(const SubScene& part, DenseRecord dense, std::vector<DenseRecord>& to) {
  dense.island = part.joints.front();
  to.push_back(dense);
}

void append_impact(const SubScene& part, const ImpactRecord& impact, const VecX& q, const VecX& p,
                   std::vector<ImpactRecord>& to) {
  to.push_back(impact);
  ImpactRecord& whole = to.back();
  whole.q = q;
  whole.p_minus = whole.p_plus = p;
  for (std::size_t i = 0; i < part.q.size(); ++i) whole.q[part.q[i]] = impact.q[static_cast<Eigen::Index>(i)];
  for (std::size_t i = 0; i < part.v.size(); ++i) {
    whole.p_minus[part.v[i]] = impact.p_minus[static_cast<Eigen::Index>(i)];
    whole.p_plus[part.v[i]] = impact.p_plus[static_cast<Eigen::Index>(i)];
  }
  whole.guard = part.guards[impact.guard];
}

}  // namespace contactvi
