// What Python sees, in parts that compilers can work on at the same time.
#pragma once

#include <nanobind/nanobind.h>

namespace pinconsist {

void bind_steppers(nanobind::module_ &m);  // steppers.cpp
void bind_gradients(nanobind::module_ &m); // gradients.cpp

} // namespace pinconsist
