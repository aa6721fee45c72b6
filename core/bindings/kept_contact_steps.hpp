// The contact steps, impacts of several points and dense steps of one call of the engine, handed from its simulator to
// the derivatives of the run through Python.
#pragma once

#include <vector>

#include "contact/contact_step_record.hpp"
#include "contact/dense_step_record.hpp"
#include "impact/impact_block_record.hpp"

namespace contactvi {

struct KeptContactSteps {
  std::vector<ContactStepRecord> steps;
  std::vector<ImpactBlockRecord> blocks;
  std::vector<DenseStepRecord> dense;
};

}  // namespace contactvi
