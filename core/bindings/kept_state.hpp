// A state of a simulator that Python keeps.
#pragma once

#include <memory>

#include "run/world.hpp"

namespace contactvi {

// A snapshot belongs to a scene, and is refused by simulators of another one.
struct Kept {
  std::shared_ptr<const SavedWorld> snapshot;
  const Scene* scene;
};

}  // namespace contactvi
