// The contact steps, impacts of several points, dense steps and smooth steps with rows of one call of the engine,
// handed from its simulator to the derivatives of the run through Python.
#pragma once

#include <vector>

#include "contact/contact_step_record.hpp"
#include "contact/dense_step_record.hpp"
#include "contact/held_step_record.hpp"
#include "impact/impact_block_record.hpp"

namespace contactvi {

struct KeptContactSteps {
  std::vector<ContactStepRecord> steps;
  std::vector<ImpactBlockRecord> blocks;
  std::vector<DenseStepRecord> dense;
  std::vector<HeldStepRecord> held;
};

}  // namespace contactvi
