// Functions of the user that a scene keeps, and calls of them.
#pragma once

#include <utility>

#include "bindings/user_calls.hpp"
#include "model/scene.hpp"

namespace contactvi {

// A function that is kept with the scene, found again by its place.
struct UserFunction {
  UserFunctions* kept;
  std::size_t index;
  template <class... Arguments>
  nanobind::object operator()(Arguments&&... arguments) const {
    return kept->list[index](std::forward<Arguments>(arguments)...);
  }
};

inline UserFunction keep(Scene& s, const nanobind::object& function) {
  std::shared_ptr<UserCalls>& owner = s.tree.elements.functions;
  if (!owner) owner = std::make_shared<UserFunctions>();
  auto* functions = static_cast<UserFunctions*>(owner.get());
  functions->list.push_back(function);
  return {functions, functions->list.size() - 1};
}

// Makes a call of the user's function with the interpreter lock; where it fails, returns `otherwise` and notes it with
// the function's owner.
template <class Result, class Call>
Result guarded(const UserFunction& function, const Result& otherwise, Call call) {
  nanobind::gil_scoped_acquire gil;
  try {
    return call();
  } catch (nanobind::python_error& error) {
    UserErrors::keep(error);
  } catch (const std::exception&) {  // the function returned something of a wrong type
  }
  function.kept->fail();
  return otherwise;
}

}  // namespace contactvi
