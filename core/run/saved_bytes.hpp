// A saved world as bytes, with which a run goes on in another process.
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "model/scene.hpp"
#include "run/saved_world.hpp"

namespace contactvi {

// The bytes do not depend on the instruction set; they belong to the scene, and to this version of the engine.
std::string bytes_of(const Scene& scene, const SavedWorld& saved);

// Refusal for bytes that are too short or too long, and for those of another scene. What else stands in them is taken
// as it is.
std::shared_ptr<const SavedWorld> saved_of(const Scene& scene, std::string_view bytes);

}  // namespace contactvi
