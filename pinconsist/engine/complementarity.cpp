// Python binding of the complementarity problems of contacts.
#include "contact_laws.hpp"

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
        [](const Mat &A, const Vec &b, const std::vector<Given> &laws, bool shared) {
          std::vector<Law> all;
          for (const auto &[at, size, pushes, limit, friction, of] : laws) all.push_back({at, size, pushes, limit, friction, of});
          const auto found = solution(A, b, all, shared);
          return nb::make_tuple(found.z, found.left);
        }, "A"_a, "b"_a, "laws"_a, "shared"_a);

  using Element = std::tuple<int, bool, int, double, bool, bool>;
  nb::class_<ContactLaws>(m, "ContactLaws")
      .def("__init__",
           [](ContactLaws *self, const std::vector<Element> &elements) {
             std::vector<ContactLaws::Element> all;
             for (const auto &[first, pushes, tangents, friction, rests, sticks] : elements)
               all.push_back({first, pushes, tangents, friction, rests, sticks});
             new (self) ContactLaws(all);
           }, "elements"_a)
      .def("obey", &ContactLaws::obey, "forces"_a)
      .def("shared", // the forces, distributed
           [](ContactLaws &laws, const Mat &R, Vec forces) {
             laws.share(R, forces);
             return forces;
           }, "R"_a, "forces"_a);
}

} // namespace pinconsist
