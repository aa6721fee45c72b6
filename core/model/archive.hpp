// Pinocchio's binary archives, the form in which models cross from Python. Reading them takes minutes to compile, so
// that one file does it (load.cpp).
#pragma once

#include <pinocchio/multibody/fwd.hpp>
#include <string_view>

namespace contactvi {

// Throws Error where the bytes are no archive of a model.
void read_model(std::string_view bytes, pinocchio::Model& model);

}  // namespace contactvi
