// The Python module contactvi._core.
#include <cstdlib>
#include <string>

#include "base/error.hpp"
#include "bindings/expose.hpp"
#include "geometry/guard.hpp"
#include "model/flat_model.hpp"

NB_MODULE(_core, m) {
  m.doc() = "Engine of contactvi. It checks sizes only: users go through the Python API.";
  nanobind::exception<contactvi::Error>(m, "CoreError", PyExc_RuntimeError);
  const char* wanted = std::getenv("CONTACTVI_INSTRUCTION_SET");
  if (wanted != nullptr && *wanted != 0 && !contactvi::set_instruction_set(wanted))
    throw nanobind::import_error(
        (std::string("CONTACTVI_INSTRUCTION_SET: this processor has no ") + wanted + "; one of base, avx2, avx512")
            .c_str());
  contactvi::settle_box_support();
  contactvi::expose_enums(m);
  contactvi::expose_scene(m);
  contactvi::expose_cone(m);
  contactvi::expose_dense(m);
  contactvi::expose_kernel(m);
  contactvi::expose_simulator(m);
  contactvi::expose_manifold(m);
  contactvi::expose_reference(m);
  contactvi::expose_sequence(m);
}
