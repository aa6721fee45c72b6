// The Python module contactvi._core.
#include <exception>
#include <stdexcept>
#include <string>

#include "base/refusal.hpp"
#include "bindings/expose.hpp"
#include "geometry/guard.hpp"

namespace {

nanobind::tuple fault(const std::string& what) {
  return nanobind::make_tuple("The engine failed", "no fault inside of the engine", what.c_str(),
                              "This is a bug: please report it with the scene");
}

// The last line of a message of coal, which begins with places in its sources, in one sentence.
std::string reason_of(std::string message) {
  while (!message.empty() && (message.back() == '\n' || message.back() == '.' || message.back() == ' '))
    message.pop_back();
  message.erase(0, message.rfind('\n') + 1);
  const std::string label = "message: ";
  if (message.compare(0, label.size(), label) == 0) message.erase(0, label.size());
  return "the library of distances said: " + message;
}

// Errors of the engine become contactvi.errors.EngineError(fact, expected, got, remedy), those of the user and faults.
void translate(const std::exception_ptr& thrown, void*) {
  namespace nb = nanobind;
  nb::tuple texts;
  try {
    std::rethrow_exception(thrown);
  } catch (const contactvi::Refusal& error) {
    texts = nb::make_tuple(error.what(), error.expected.c_str(), error.got.c_str(), error.remedy.c_str());
  } catch (const contactvi::Error& error) {
    texts = fault(error.what());
  } catch (const nb::builtin_exception&) {  // of the bindings, as for an index out of range
    throw;
  } catch (const std::logic_error& error) {  // of coal, and so is the next one
    texts = fault(reason_of(error.what()));
  } catch (const std::runtime_error& error) {
    texts = fault(reason_of(error.what()));
  }
  PyErr_SetObject(nb::module_::import_("contactvi.errors").attr("EngineError").ptr(), texts.ptr());
}

}  // namespace

NB_MODULE(_core, m) {
  m.doc() = "Engine of contactvi. It checks sizes only: users go through the Python API.";
  nanobind::register_exception_translator(translate);
  contactvi::settle_box_support();
  contactvi::expose_enums(m);
  contactvi::expose_model(m);
  contactvi::expose_scene(m);
  contactvi::expose_cone(m);
  contactvi::expose_dense(m);
  contactvi::expose_derivatives(m);
  contactvi::expose_sensitivity(m);
  contactvi::expose_hull(m);
  contactvi::expose_kernel(m);
  contactvi::expose_simulator(m);
  contactvi::expose_runs_apart(m);
  contactvi::expose_batch(m);
  contactvi::expose_manifold(m);
  contactvi::expose_sequence(m);
}
