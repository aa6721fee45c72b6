// Calls of the user's Python functions from the engine, where no exception may pass: the first one is kept.
#pragma once

#include <nanobind/nanobind.h>

#include <memory>
#include <vector>

#include "model/elements.hpp"

namespace contactvi {

// The Python functions that a scene calls. Held here, where the garbage collector can see them, since they like to hold
// the scene in turn.
struct UserFunctions : UserCalls {
  std::vector<nanobind::object> list;
};

class UserErrors {
 public:
  // Keeps the exception under way, if it is the first; the interpreter lock is held.
  static void keep(nanobind::python_error& error);
  static bool any() { return !kept().is_none(); }
  // The exception object kept, None if there is none; nothing is kept afterwards.
  static nanobind::object take();
  // Raises what is kept.
  static void raise();

 private:
  static nanobind::object& kept();
};

// Slots of the type Scene for the garbage collector.
extern PyType_Slot scene_slots[];

}  // namespace contactvi
