// Contact steps, dense steps, smooth steps with rows and impacts of several points as numbers, in which files keep
// them.
//
// Whole numbers and truth values are numbers too; a 64-bit one is two. Matrices have their sizes in front. What a step
// leaves unset, such as the anchor of a contact without one, is zero.
#pragma once

#include <vector>

#include "contact/contact_step_record.hpp"
#include "contact/dense_step_record.hpp"
#include "contact/held_step_record.hpp"
#include "impact/impact_block_record.hpp"
#include "model/scene.hpp"

namespace contactvi {

std::vector<double> numbers_of(const std::vector<ContactStepRecord>& steps);
std::vector<double> numbers_of(const std::vector<ImpactBlockRecord>& blocks);
std::vector<double> numbers_of(const std::vector<DenseStepRecord>& steps);
std::vector<double> numbers_of(const std::vector<HeldStepRecord>& steps);
// What laws of contact beside Coulomb's with one number need, which files of older versions lack.
std::vector<double> law_numbers_of(const std::vector<ContactStepRecord>& steps);
std::vector<double> law_numbers_of(const std::vector<HeldStepRecord>& steps);

// All raise a Refusal for numbers that are not those of such records of this scene. laws: of law_numbers_of; empty: of
// an older version.
std::vector<ContactStepRecord> contact_steps_of(const Scene& scene, const VecX& numbers, const VecX& laws);
std::vector<ImpactBlockRecord> impact_blocks_of(const Scene& scene, const VecX& numbers);
std::vector<DenseStepRecord> dense_steps_of(const Scene& scene, const VecX& numbers);
std::vector<HeldStepRecord> held_steps_of(const Scene& scene, const VecX& numbers, const VecX& laws);

}  // namespace contactvi
