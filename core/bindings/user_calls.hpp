// Calls of the user's Python functions from the engine. No exception may pass through it, so the first one is kept.
#pragma once

#include <nanobind/nanobind.h>

#include <memory>
#include <vector>

#include "model/elements.hpp"

namespace contactvi {

// The Python functions that a scene calls. They stand where the garbage collector can see them, because they often hold
// the scene in turn.
struct UserFunctions : UserCalls {
  std::vector<nanobind::object> list;
};

class UserErrors {
 public:
  // Keeps the present exception if it is the first one. The caller has the interpreter lock.
  static void keep(nanobind::python_error& error);
  static bool any() { return !kept().is_none(); }
  // Returns the exception object that was kept, None without one, and forgets it.
  static nanobind::object take();
  // Raises the exception that was kept, if there is one.
  static void raise();

 private:
  static nanobind::object& kept();
};

// The slots by which the garbage collector visits a Scene.
extern PyType_Slot scene_slots[];

}  // namespace contactvi
