#include "error.hpp"
#include "expose.hpp"
#include "guard.hpp"

NB_MODULE(_core, m) {
  m.doc() = "Engine of contactvi. Checks sizes only: users go through the Python face.";
  nanobind::exception<contactvi::Error>(m, "CoreError", PyExc_RuntimeError);
  contactvi::settle_box_support();
  contactvi::expose_scene(m);
  contactvi::expose_dense(m);
  contactvi::expose_kernel(m);
  contactvi::expose_simulator(m);
  contactvi::expose_reference(m);
}
