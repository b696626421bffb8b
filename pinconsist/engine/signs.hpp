// The signs of users' functions and of contacts along a run.
#pragma once

#include "watch.hpp"

#include <algorithm>

namespace pinconsist {

// Read-only numbers for a user's function; a new array if the function has kept the last one.
class Given {
public:
  const nb::object &operator()(const Vec &x) {
    if (array_.is_valid() && Py_REFCNT(array_.ptr()) == 1 && x.size() == size_) {
      std::memcpy(numbers_, x.data(), size_ * sizeof(double));
      return array_;
    }
    array_ = array(x);
    size_ = x.size();
    Py_buffer view;
    if (PyObject_GetBuffer(array_.ptr(), &view, PyBUF_WRITABLE)) throw nb::python_error();
    numbers_ = view.buf;
    PyBuffer_Release(&view);
    array_.attr("setflags")(false);
    return array_;
  }

private:
  nb::object array_;
  Eigen::Index size_ = 0;
  void *numbers_ = nullptr;
};

class Signs {
public:
  double begin = 0.0, end = 0.0;
  std::vector<double> before, values;
  bool changed = false;
  const bool with_multipliers;

  // The owner of the signs keeps these functions alive; the garbage collector does not see them here. Functions get all
  // multipliers: from `finish` or, if it is None, with zeros except at these places. The values of `contacts`, if it is not
  // null, come after those of the functions.
  Signs(const nb::tuple &events, bool with_multipliers, nb::handle interrupted, nb::handle finish,
        std::vector<int> places, int number, ContactWatch *contacts)
      : with_multipliers(with_multipliers), interrupted_(interrupted), finish_(finish), places_(std::move(places)),
        all_(Vec::Zero(number)), contacts_(contacts) {
    for (const nb::handle event : events) {
      events_.push_back(event);
      functions_.push_back(nb::handle(nb::object(event.attr("function")).ptr()));
    }
    before.resize(events_.size() + (contacts ? contacts->size() : 0));
    values.resize(before.size());
  }

  // `leaving` has values for the functions that leave zero, NaN for others; `offsets` are taken off up to the first look.
  void restart(double t, const Vec &p, const Vec &v, const Vec &lam, std::vector<double> leaving,
               std::vector<double> offsets) {
    begin = end = t;
    leaving_ = std::move(leaving);
    offsets_.clear();
    for (size_t i = 0; i < values.size(); ++i) {
      values[i] = leaving_.empty() || std::isnan(leaving_[i]) ? value(i, t, p, v, lam) : leaving_[i];
    }
    offsets_ = std::move(offsets);
    first_ = true;
  }

  // Whether a function has left zero at the beginning of the last two evaluations, and has the sign that it had then.
  bool leaves(size_t i) const { return i < leaving_.size() && !std::isnan(leaving_[i]) && leaving_[i] != 0.0; }

  bool look(double t, const Vec &p, const Vec &v, const Vec &lam) {
    was_first_ = first_;
    if (!std::exchange(first_, false)) {
      leaving_.clear();
      offsets_.clear();
    }
    if (contacts_) contacts_->advance();
    begin = std::exchange(end, t);
    before.swap(values);
    changed = false;
    for (size_t i = 0; i < values.size(); ++i) {
      values[i] = value(i, t, p, v, lam);
      changed = changed || (before[i] != 0.0 && !(before[i] * values[i] > 0.0));
    }
    return changed;
  }

  // A time between the last two evaluations at which a contact may close and open again; NaN if there is none.
  double doubtful() const {
    const double t = contacts_ ? contacts_->doubtful() : NOT_A_NUMBER;
    return (t - begin) * (t - end) < 0.0 ? t : NOT_A_NUMBER;
  }

  // Take back the last evaluation.
  void back() {
    first_ = was_first_;
    end = begin;
    values = before;
    contacts_->back();
  }

  bool interrupted() const { return nb::cast<bool>(interrupted_()); }

  bool at_zero() const { return std::count(values.begin(), values.end(), 0.0); }

  double value(size_t i, double t, const Vec &p, const Vec &v, const Vec &lam) {
    if (i >= events_.size()) {
      const double found = contacts_->value(i - events_.size(), t, p, v, lam);
      return i < offsets_.size() ? found - offsets_[i] : found;
    }
    nb::object error = nb::none();
    double found = NOT_A_NUMBER;
    try {
      const nb::object given = with_multipliers ? all(p, v, lam) : nb::none();
      found = PyFloat_AsDouble(functions_[i](t, p_(p), v_(v), given).ptr());
      if (PyErr_Occurred()) throw nb::python_error();
    } catch (nb::python_error &raised) {
      if (!raised.matches(PyExc_Exception)) throw;
      error = nb::borrow(raised.value());
      found = NOT_A_NUMBER;
    }
    if (std::isnan(found)) events_[i].attr("_raise_failure")(t, error);
    return i < offsets_.size() ? found - offsets_[i] : found;
  }

private:
  nb::object all(const Vec &p, const Vec &v, const Vec &lam) {
    if (!finish_.is_none()) return finish_(array(p), array(lam), array(v));
    for (size_t i = 0; i < places_.size(); ++i) all_[places_[i]] = lam[i];
    return lam_(all_);
  }

  std::vector<double> leaving_, offsets_; // between a restart and the look after the first one
  bool first_ = false, was_first_ = false;
  std::vector<nb::handle> events_, functions_;
  nb::handle interrupted_, finish_;
  std::vector<int> places_;
  Vec all_;
  Given p_, v_, lam_;
  ContactWatch *contacts_;
};

} // namespace pinconsist
