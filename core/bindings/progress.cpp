#include "bindings/progress.hpp"

#include "bindings/user_calls.hpp"

namespace nb = nanobind;

namespace contactvi {

namespace {

// False where a signal handler of Python raised, whose error is kept: while it is set, no function of the user can be
// called.
bool no_signal() {
  if (PyErr_CheckSignals() == 0) return !UserErrors::any();
  nb::python_error error;
  UserErrors::keep(error);
  return false;
}

}  // namespace

Progress wrapped(const std::optional<ProgressCallback>& callback) {
  if (!callback) {
    return [](double, long) {
      nb::gil_scoped_acquire gil;
      return no_signal();
    };
  }
  return [&callback](double t, long impacts) {
    nb::gil_scoped_acquire gil;
    if (!no_signal()) return false;
    try {
      (*callback)(t, impacts);
    } catch (nb::python_error& error) {
      UserErrors::keep(error);  // run() hands it over
      return false;
    }
    return true;
  };
}

}  // namespace contactvi
