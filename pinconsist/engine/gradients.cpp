// Python bindings of the gradients.
#include "gradient.hpp"

#include <nanobind/stl/vector.h>

namespace pinconsist {
namespace {

using namespace nb::literals;

// Binds a method that goes along steps; releases the GIL unless Python is called.
template <class... Given> auto along(int (Derivatives::*method)(Given...)) {
  return [method](Derivatives &of, Given... given) {
    if (of.calls_python()) return (of.*method)(given...);
    nb::gil_scoped_release release;
    return (of.*method)(given...);
  };
}

} // namespace

void bind_gradients(nb::module_ &m) {
  nb::class_<StageSteps>(m, "StageSteps")
      .def(nb::init<Vec, Vec, Vec, Table, Table, Table, Table, Integers, Vec>())
      .def_ro("t", &StageSteps::t)
      .def_ro("p", &StageSteps::p)
      .def_ro("v", &StageSteps::v)
      .def_ro("W", &StageSteps::W);
  nb::class_<Derivatives>(m, "Derivatives")
      .def(nb::init<System &>(), "system"_a, nb::keep_alive<1, 2>())
      .def("use_parameters", [](Derivatives &of, int number) { of.parameters.use(number); })
      .def("add_term", [](Derivatives &of, int column, double weight, System &other) { of.parameters.add_term(column, weight, other); },
           nb::keep_alive<1, 4>())
      .def("use_known", [](Derivatives &of, System &rates) { of.parameters.known = &dynamic_cast<Known &>(rates); },
           nb::keep_alive<1, 2>())
      .def("again", along(&Derivatives::again))
      .def("forward", along(&Derivatives::forward))
      .def("backward", along(&Derivatives::backward))
      .def("multipliers", along(&Derivatives::multipliers))
      .def("multipliers_back", along(&Derivatives::multipliers_back));
}

} // namespace pinconsist
