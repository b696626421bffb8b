// The formulas of engine/bdf.py. The table Z has ROWS rows ∇ʲ[ξ | v | λ], stored row by row.
#pragma once

#include "system.hpp"

#include <array>

namespace pinconsist::bdf {

constexpr int ROWS = MAX_ORDER + 3;

inline double gamma(int j) {
  static const auto sums = [] {
    std::array<double, MAX_ORDER + 1> sums{};
    for (int i = 1; i <= MAX_ORDER; ++i) sums[i] = sums[i - 1] + 1.0 / i;
    return sums;
  }();
  return sums[j];
}
inline double alpha(int k) { return gamma(k); }
inline double error_constant(int k) { return 1.0 / (k + 1); }

inline double binomial(int j, int i) {
  double result = 1.0;
  for (int m = 1; m <= i; ++m) result = result * (j - i + m) / m;
  return std::round(result);
}

// Past values to differences, and differences back to values.
inline const Mat &differences(int k) {
  static const auto all = [] {
    std::vector<Mat> all;
    for (int k = 0; k < ROWS; ++k) {
      Mat D = Mat::Zero(k + 1, k + 1);
      for (int j = 0; j <= k; ++j)
        for (int i = 0; i <= j; ++i) D(j, i) = (i % 2 ? -1.0 : 1.0) * binomial(j, i);
      all.push_back(D);
    }
    return all;
  }();
  return all[k];
}

// Rows 0..k of Z to the differences for step factor·h of the same interpolating polynomial.
inline void rescale(int k, double factor, Table &Z) {
  Mat nodes = Mat::Zero(k + 1, k + 1); // Newton's basis polynomial j at i new steps back from t_n
  for (int i = 0; i <= k; ++i) {
    nodes(i, 0) = 1.0;
    for (int j = 0; j < k; ++j) nodes(i, j + 1) = nodes(i, j) * (j - i * factor) / (j + 1);
  }
  const Mat change = differences(k) * nodes;
  const Table old = Z.topRows(k + 1);
  Z.topRows(k + 1).noalias() = change * old;
}

// Advances the table to n+1; `d` is y_{n+1} minus its prediction.
inline void advance(int k, const Vec &d, Table &Z) {
  Z.row(k + 2) = d.transpose() - Z.row(k + 1);
  Z.row(k + 1) = d.transpose();
  for (int j = k; j >= 0; --j) Z.row(j) += Z.row(j + 1);
}

inline void recenter(System &system, const Vec &base, const Vec &new_base, Table &Z, int rows) {
  const Mat &D = differences(rows - 1);
  const int nx = system.nx;
  Table past = D * Z.topLeftCorner(rows, nx);
  Vec there(system.npos), xi(nx);
  for (int i = 0; i < rows; ++i) {
    system.integrate(base, past.row(i).transpose(), there);
    system.difference(new_base, there, xi);
    past.row(i) = xi.transpose();
  }
  Z.topLeftCorner(rows, nx) = D * past;
}

inline double fastest_turn(const Mat &turns, const Vec &rate) {
  return turns.rows() ? std::sqrt((turns * rate.cwiseAbs2()).maxCoeff()) : 0.0;
}

inline void extrapolate(int k, const Table &Z, Vec &predicted, Vec &psi) {
  predicted = Z.row(0).transpose();
  psi = predicted;
  for (int j = 1; j <= k; ++j) {
    predicted += Z.row(j).transpose();
    psi += (1.0 - gamma(j) / alpha(k)) * Z.row(j).transpose();
  }
}

// Prediction and ψ; moves the table to the chart at the predicted position if there are charts.
inline void predict(System &system, int k, Vec &base, Table &Z, Vec &predicted, Vec &psi) {
  extrapolate(k, Z, predicted, psi);
  if (system.vector_like) {
    base = predicted.head(system.nx);
    return;
  }
  Vec centre(system.npos);
  system.integrate(base, predicted.head(system.nx), centre);
  recenter(system, base, centre, Z, k + 2);
  base = centre;
  extrapolate(k, Z, predicted, psi);
}

} // namespace pinconsist::bdf
