// Python bindings of the gradients.
#include "gradient.hpp"
#include "stage_follow.hpp"

#include <nanobind/stl/vector.h>

namespace pinconsist {
namespace {

using namespace nb::literals;

// Binds a method that goes along steps; releases the GIL unless Python is called.
template <class Along, class... Given> auto along(int (Along::*method)(Given...)) {
  return [method](Along &way, Given... given) {
    if (way.calls_python()) return (way.*method)(given...);
    nb::gil_scoped_release release;
    return (way.*method)(given...);
  };
}

} // namespace

void bind_gradients(nb::module_ &m) {
  nb::class_<Way>(m, "Way")
      .def("use_parameters", [](Way &way, int number) { way.parameters.use(number); })
      .def("add_term", [](Way &way, int column, double weight, System &other) { way.parameters.add_term(column, weight, other); },
           nb::keep_alive<1, 4>())
      .def("use_known", [](Way &way, System &rates) { way.parameters.known = &dynamic_cast<Known &>(rates); }, nb::keep_alive<1, 2>());

  nb::class_<Leg>(m, "Leg").def(nb::init<Vec, Vec, Integers, Table, Table, Integers, Table>());
  nb::class_<Derivatives, Way>(m, "Derivatives")
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("forward", along(&Derivatives::forward))
      .def("backward", along(&Derivatives::backward));

  nb::class_<StageSteps>(m, "StageSteps")
      .def(nb::init<Vec, Vec, Vec, Table, Table, Table, Table, Integers, Vec>())
      .def_ro("p", &StageSteps::p)
      .def_ro("v", &StageSteps::v)
      .def_ro("W", &StageSteps::W);
  nb::class_<StageDerivatives, Way>(m, "StageDerivatives")
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("again", along(&StageDerivatives::again))
      .def("forward", along(&StageDerivatives::forward))
      .def("backward", along(&StageDerivatives::backward))
      .def("multipliers", along(&StageDerivatives::multipliers))
      .def("multipliers_back", along(&StageDerivatives::multipliers_back));
}

} // namespace pinconsist
