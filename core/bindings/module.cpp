// The Python module contactvi._core.
#include <exception>

#include "base/refusal.hpp"
#include "bindings/expose.hpp"
#include "geometry/guard.hpp"

namespace {

// Errors of the engine become contactvi.errors.EngineError(fact, expected, got, remedy), those of the user and faults.
void translate(const std::exception_ptr& thrown, void*) {
  namespace nb = nanobind;
  nb::tuple texts;
  try {
    std::rethrow_exception(thrown);
  } catch (const contactvi::Refusal& error) {
    texts = nb::make_tuple(error.what(), error.expected.c_str(), error.got.c_str(), error.remedy.c_str());
  } catch (const contactvi::Error& error) {
    texts = nb::make_tuple("The engine failed", "no fault inside of the engine", error.what(),
                           "This is a bug: please report it with the scene");
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
  contactvi::expose_batch(m);
  contactvi::expose_manifold(m);
  contactvi::expose_sequence(m);
}
