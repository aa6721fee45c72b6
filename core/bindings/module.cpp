#include "error.hpp"
#include "expose.hpp"

NB_MODULE(_core, m) {
  m.doc() = "Engine of contactvi. Checks sizes only: users go through the Python face.";
  nanobind::exception<contactvi::Error>(m, "CoreError", PyExc_RuntimeError);
  contactvi::expose_scene(m);
  contactvi::expose_simulator(m);
  contactvi::expose_reference(m);
}
