#include "run/part_records.hpp"

namespace contactvi {

void append_contact(const SubScene& part, const ContactRow& contact, std::vector<ContactRow>& to) {
  to.push_back(contact);
  to.back().guard = part.guards[contact.guard];
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
