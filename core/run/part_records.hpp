// What a part of a scene has recorded, in the numbers of the whole scene.
#pragma once

#include "model/static_trees.hpp"
#include "record/recording.hpp"

namespace contactvi {

void append_contact(const SubScene& part, const ContactRow& contact, std::vector<ContactRow>& to);
void append_change(const SubScene& part, ChangeRecord change, std::vector<ChangeRecord>& to);
void append_dense(const SubScene& part, DenseRecord dense, std::vector<DenseRecord>& to);
// Appends an impact of the part; q, p: of the whole scene at its time, of which the entries of the part are set here.
void append_impact(const SubScene& part, const ImpactRecord& impact, const VecX& q, const VecX& p,
                   std::vector<ImpactRecord>& to);

}  // namespace contactvi
