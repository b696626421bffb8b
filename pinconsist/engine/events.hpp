// The events of a run: zeros of users' functions and of contacts, in order of time, and what follows from them.
#pragma once

#include "watch.hpp"

#include <algorithm>
#include <optional>

namespace pinconsist {

// Read-only numbers for a user's function; a new array if the function has kept the last one.
class ReadOnly {
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

// A state of a run.
struct Located {
  double t;
  Vec p, v, lam;
};

// Events at one time that change a run, the state there, and whether they end it.
struct Hit {
  std::vector<size_t> events;
  Located at;
  bool ends = false;
};

class Events {
public:
  struct Occurrence {
    double t;
    Vec p, v;
  };

  // The last two evaluations: their times, the values there, and whether the sign of one has changed.
  double begin = 0.0, end = 0.0;
  std::vector<double> before, values;
  bool changed = false;
  std::vector<std::vector<Occurrence>> found; // of each user's function

  // The owner keeps the functions alive; the garbage collector does not see them here. Events are passed as tuples of the
  // event, its function, direction, number of occurrences that end the run or 0, whether it changes the state, whether it
  // is an impact, whose function cannot become negative, and whether the function may use λ. They get all multipliers:
  // from `finish` or, if it is None, with zeros except at `places`. ``interrupted()`` says whether a signal has come.
  Events(const nb::list &events, nb::handle interrupted, nb::handle finish, std::vector<int> places, int number)
      : interrupted_(interrupted), finish_(finish), places_(std::move(places)), all_(Vec::Zero(number)) {
    for (const nb::handle each : events) add(nb::cast<nb::tuple>(each));
    own_ = watched_.size();
    found.resize(own_);
    last_change_.resize(own_);
    flights_.resize(own_);
    resize(nullptr);
  }

  // Watch for the end of a mode of contacts, in place of that of the last one.
  void enter_mode(ContactWatch *contacts) { resize(contacts); }

  size_t size() const { return values.size(); }
  size_t own() const { return own_; }
  bool with_multipliers() const { return with_multipliers_; }
  bool interrupted() const { return nb::cast<bool>(interrupted_()); }

  // Take the values at a new start. What is about zero and cannot become negative rises from there.
  void restart(double t, const Vec &p, const Vec &v, const Vec &lam) {
    take(t, p, v, lam);
    Leaving leaving = contacts_leaving();
    for (size_t i = 0; i < own_; ++i)
      if (watched_[i].one_sided && values[i] <= TOUCHING) leaving[i] = TOUCHING;
    leave(leaving);
  }

  // Take the values after the events `fired`, with acceleration and multipliers there. The values of their functions are only
  // rounding there, unless one of them has `moved` the position. Their signs are those with which they leave zero, so that
  // they are right however soon it returns, and what they have of the other sign is rounding. Returns the event that
  // accumulates, or -1.
  int restart_after(const System &system, const std::vector<size_t> &fired, bool moved, double t, const Vec &p, const Vec &v,
                    const Vec &a, const Vec &lam, bool forward) {
    take(t, p, v, lam);
    Leaving leaving = contacts_leaving();
    std::vector<size_t> reversed;
    for (size_t i = 0; i < own_; ++i) {
      const bool has_fired = std::count(fired.begin(), fired.end(), i);
      if (watched_[i].one_sided) {
        if (has_fired || values[i] <= TOUCHING) leaving[i] = TOUCHING;
        if (has_fired) reversed.push_back(i);
      } else if (has_fired) {
        leaving[i] = 0.0;
        if (depends_on_multipliers(i, t, p, v, lam)) continue;
        const Occurrence last = found[i].back();
        const double rate = departure(i, system, t, p, v, a, lam, forward);
        const double arrived = departure(i, system, last.t, last.p, last.v, a, lam, forward);
        leaving[i] = std::abs(rate) > STOPPED * std::abs(arrived) ? rate : 0.0;
        if (leaving[i] * arrived <= 0.0) reversed.push_back(i);
        if (moved && std::abs(values[i]) > std::max(std::abs(rate), std::abs(arrived))) leaving[i] = NOT_A_NUMBER;
      }
    }
    leave(leaving);
    for (size_t i : reversed)
      if (accumulates(i, t, p)) return static_cast<int>(i);
    return -1;
  }

  // An event has changed the velocities by so much.
  void has_changed(size_t i, double change) { last_change_[i] = change; }

  // Take the values after a jump of forces, which may move a function past zero.
  std::optional<Hit> jumped(const Located &at) {
    const std::vector<double> last = values;
    take(at.t, at.p, at.v, at.lam);
    std::vector<std::pair<size_t, Located>> hits;
    for (size_t i = 0; i < values.size(); ++i)
      if (passes(i, last[i], values[i])) hits.emplace_back(i, at);
    return happen(hits);
  }

  // Before a change of the modes of contacts, where λ jumps: keep the values of users' functions that may use λ.
  void keep_of_multipliers(double t, const Vec &p, const Vec &v, const Vec &lam) {
    kept_.assign(own_, NOT_A_NUMBER);
    for (size_t i = 0; i < own_; ++i)
      if (watched_[i].reads) kept_[i] = value(i, t, p, v, lam);
  }

  // The events, except those that have `fired`, whose kept values have passed zero.
  std::optional<Hit> passed(const std::vector<size_t> &fired, const Located &at) {
    std::vector<std::pair<size_t, Located>> hits;
    for (size_t i = 0; i < kept_.size(); ++i) {
      if (std::isnan(kept_[i]) || std::count(fired.begin(), fired.end(), i)) continue;
      if (passes(i, kept_[i], value(i, at.t, at.p, at.v, at.lam))) hits.emplace_back(i, at);
    }
    return happen(hits);
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

  // A step begins where the last look was.
  void begin_step() {
    if (contacts_) contacts_->begin_step();
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

  bool at_zero() const { return std::count(values.begin(), values.end(), 0.0); }

  // Record the events between the last two evaluations, in order of time, up to the first that changes the run, if there
  // is one. ``locate(i, limit)`` gives the time and state of one; with a `limit`, in a step that ends there, if it is
  // earlier. False if one is not found because the equations are singular.
  template <class Locate> bool search(const Locate &locate, std::optional<Hit> &hit) {
    changed = false;
    std::vector<std::pair<size_t, Located>> hits;
    for (size_t i = 0; i < values.size(); ++i) {
      if (!passes(i, before[i], values[i])) continue;
      const auto at = locate(i, NOT_A_NUMBER);
      if (!at) return false;
      hits.emplace_back(i, *at);
    }
    std::stable_sort(hits.begin(), hits.end(), [&](const auto &one, const auto &other) {
      return std::abs(one.second.t - begin) < std::abs(other.second.t - begin);
    });
    if (contacts_ && !hits.empty()) add_sooner(locate, hits);
    hit = happen(hits);
    return true;
  }

  double value(size_t i, double t, const Vec &p, const Vec &v, const Vec &lam) {
    const double found = i < watched_.size() ? of_function(i, t, p, v, lam) : contacts_->value(i - watched_.size(), t, p, v, lam);
    return i < offsets_.size() ? found - offsets_[i] : found;
  }

private:
  // A function in Python.
  struct Watched {
    nb::handle event, function;
    double direction;
    long terminal;
    bool applies, one_sided, reads;
  };
  using Leaving = std::vector<double>; // values of the functions that leave zero, NaN for others

  void add(const nb::tuple &about) {
    const auto flag = [&](size_t i) { return nb::cast<bool>(about[i]); };
    watched_.push_back({nb::handle(nb::object(about[0]).ptr()), nb::handle(nb::object(about[1]).ptr()), nb::cast<double>(about[2]),
                        nb::cast<long>(about[3]), flag(4), flag(5), flag(6)});
  }

  void resize(ContactWatch *contacts) {
    contacts_ = contacts;
    with_multipliers_ = contacts && contacts->with_multipliers();
    for (const Watched &each : watched_) with_multipliers_ = with_multipliers_ || each.reads;
    before.resize(watched_.size() + (contacts ? contacts->size() : 0));
    values.resize(before.size());
    leaving_.clear();
    offsets_.clear();
  }

  // Whether a function passes zero from one value to another, in its direction.
  bool passes(size_t i, double g0, double g1) const {
    const double direction = i < own_ ? watched_[i].direction : -1.0;
    return (g0 < 0.0 && g1 >= 0.0 && direction >= 0.0) || (g0 > 0.0 && g1 <= 0.0 && direction <= 0.0);
  }

  static bool at_once(double t1, double t2) { return std::abs(t1 - t2) <= SAME_TIME * std::max(1.0, std::abs(t1)); }

  // Record events, in order of time, up to the first that changes the run.
  std::optional<Hit> happen(const std::vector<std::pair<size_t, Located>> &hits) {
    std::optional<Hit> stop;
    for (const auto &[i, at] : hits) {
      if (stop && !at_once(at.t, stop->at.t)) break;
      bool ends = false, stops = true;
      if (i < own_) {
        found[i].push_back({at.t, at.p, at.v});
        ends = watched_[i].terminal && static_cast<long>(found[i].size()) >= watched_[i].terminal;
        stops = ends || watched_[i].applies;
      }
      if (stops && !stop) stop = Hit{{}, at};
      if (stop) stop->ends = stop->ends || ends;
    }
    if (stop)
      for (const auto &[i, at] : hits)
        if (at_once(at.t, stop->at.t)) stop->events.push_back(i);
    return stop;
  }

  // Add gaps that have closed before the first of the hits, as a shorter step than the last one shows.
  template <class Locate> void add_sooner(const Locate &locate, std::vector<std::pair<size_t, Located>> &hits) {
    for (int turn = 0; turn < SOONER; ++turn) {
      const auto [first, at] = hits.front();
      std::optional<std::pair<size_t, Located>> sooner;
      for (size_t i = watched_.size(); i < values.size(); ++i) {
        const bool closed = i != first && contacts_->is_gap(i - watched_.size()) && before[i] > 0.0 &&
                            value(i, at.t, at.p, at.v, at.lam) < -DEEP_GAP;
        const auto found = closed ? locate(i, at.t) : std::optional<Located>{};
        if (found && found->t < (sooner ? sooner->second.t : at.t)) sooner.emplace(i, *found);
      }
      if (!sooner) return;
      hits.insert(hits.begin(), *sooner);
    }
  }

  void take(double t, const Vec &p, const Vec &v, const Vec &lam) {
    begin = end = t;
    leaving_.clear();
    offsets_.clear();
    for (size_t i = 0; i < values.size(); ++i) values[i] = value(i, t, p, v, lam);
    first_ = true;
  }

  // Functions of contacts are positive in their mode: what is about zero at its beginning rises from there.
  Leaving contacts_leaving() const {
    Leaving leaving(values.size(), NOT_A_NUMBER);
    for (size_t i = own_; i < values.size(); ++i)
      if (values[i] <= TOUCHING) leaving[i] = TOUCHING;
    return leaving;
  }

  // After `take`: the signs of functions that leave zero. What they have of the other sign is taken off up to the first look.
  void leave(const Leaving &leaving) {
    leaving_ = leaving;
    offsets_.assign(values.size(), 0.0);
    for (size_t i = 0; i < values.size(); ++i) {
      if (std::isnan(leaving[i])) continue;
      if (values[i] * leaving[i] < 0.0) offsets_[i] = values[i];
      values[i] = leaving[i];
    }
  }

  // Whether a function uses λ, and not only gets it.
  bool depends_on_multipliers(size_t i, double t, const Vec &p, const Vec &v, const Vec &lam) {
    return watched_[i].reads && value(i, t, p, v, Vec(2.0 * lam + Vec::Ones(lam.size()))) != values[i];
  }

  // The change of a function over a short time after an event, of first order.
  double departure(size_t i, const System &system, double t, const Vec &p, const Vec &v, const Vec &a, const Vec &lam, bool forward) {
    const Vec rate = system.rate(t, p, v);
    const double time = FLIGHT * (1.0 + largest(p)) / (1.0 + largest(rate) + largest(a)) * (forward ? 1.0 : -1.0);
    const auto beside = [&](double dt) {
      Vec moved;
      system.integrate(p, dt * rate, moved);
      return value(i, t + dt, moved, v + dt * a, lam);
    };
    return 0.5 * (beside(time) - beside(-time));
  }

  // Whether the flights between occurrences of an event that reverses its function have become too short to be resolved.
  bool accumulates(size_t i, double t, const Vec &p) {
    const size_t n = found[i].size();
    if (!watched_[i].applies || n < 2) return false;
    const double flight = std::abs(found[i][n - 1].t - found[i][n - 2].t);
    const double height = last_change_[i] * flight / 8.0; // of a parabola
    const bool immediate = flight <= shortest_step(t);
    const bool brief = immediate || height <= ROUNDED_FLIGHT * EPS * (1.0 + largest(p));
    flights_[i] = brief ? flights_[i] + 1 : 0;
    double most = FLIGHTS;
    if (immediate) most = watched_[i].one_sided ? FLIGHTS_AT_ONCE : 1.0; // several impacts at one time may take turns
    return flights_[i] >= most;
  }

  double of_function(size_t i, double t, const Vec &p, const Vec &v, const Vec &lam) {
    nb::object error = nb::none();
    double found = NOT_A_NUMBER;
    try {
      const nb::object multipliers = with_multipliers_ ? all(p, v, lam) : nb::none();
      found = PyFloat_AsDouble(watched_[i].function(t, p_(p), v_(v), multipliers).ptr());
      if (PyErr_Occurred()) throw nb::python_error();
    } catch (nb::python_error &raised) {
      if (!raised.matches(PyExc_Exception)) throw;
      error = nb::borrow(raised.value());
      found = NOT_A_NUMBER;
    }
    if (std::isnan(found)) watched_[i].event.attr("_raise_failure")(t, error);
    return found;
  }

  nb::object all(const Vec &p, const Vec &v, const Vec &lam) {
    if (!finish_.is_none()) return finish_(array(p), array(lam), array(v));
    for (size_t i = 0; i < places_.size(); ++i) all_[places_[i]] = lam[i];
    return lam_(all_);
  }

  static constexpr int SOONER = 8; // times that a gap is sought that has closed before the first event

  std::vector<Watched> watched_;
  size_t own_ = 0; // number of users' events, which come first
  bool with_multipliers_ = false;
  Leaving leaving_; // between a restart and the look after the first one
  std::vector<double> offsets_, kept_, last_change_;
  std::vector<int> flights_;
  bool first_ = false, was_first_ = false;
  nb::handle interrupted_, finish_;
  std::vector<int> places_;
  Vec all_;
  ReadOnly p_, v_, lam_;
  ContactWatch *contacts_ = nullptr;
};

} // namespace pinconsist
