// Python binding of the complementarity problems of contacts.
#include "complementarity.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

namespace pinconsist {

namespace nb = nanobind;
using namespace nb::literals;

void bind_complementarity(nb::module_ &m) {
  using Given = std::tuple<int, int, bool, double, double, int>;
  m.def("complementarity", // z, and what is left of the laws
        [](const Mat &A, const Vec &b, const std::vector<Given> &laws) {
          std::vector<Law> all;
          for (const auto &[at, size, pushes, limit, friction, of] : laws) all.push_back({at, size, pushes, limit, friction, of});
          const Complementarity found(A, b, all);
          return nb::make_tuple(found.z, found.left);
        }, "A"_a, "b"_a, "laws"_a);
}

} // namespace pinconsist
