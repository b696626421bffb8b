// Whether the constraint rows in use are still a good choice, where rows depend on each other.
#pragma once

#include "mechanism.hpp"

namespace pinconsist {

class KeptRows {
public:
  // `all` has all rows, of typical sizes `scales`; their Jacobians are compared at time t.
  KeptRows(MechanismSystem &all, std::vector<int> kept, const Vec &scales, double t)
      : all_(all), kept_(std::move(kept)), scales_(scales), t_(t) {}

  // Whether the smallest singular value of the kept rows is far below that of all rows.
  bool poor(const Vec &p); // in module.cpp

private:
  MechanismSystem &all_;
  std::vector<int> kept_;
  Vec scales_;
  double t_;
};

} // namespace pinconsist
