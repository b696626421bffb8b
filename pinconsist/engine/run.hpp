// What the runs of both methods share: the loop around the steps, events, rows, changes of forces.
#pragma once

#include "control.hpp"
#include "events.hpp"
#include "index1.hpp"
#include "kept_rows.hpp"

#include <chrono>

namespace pinconsist {

template <class Numbers> void put(std::vector<double> &to, const Numbers &x) {
  to.insert(to.end(), x.data(), x.data() + x.size());
}

// Why the loop is left: Python acts on it, and calls again.
enum class Reason {
  end,      // the end of the interval is reached
  event,    // an event changes the run, or ends it
  rows,     // other rows of the constraints should be kept
  steps,    // as many steps as were asked for have been made, or LONGEST_CALL is at its end
  callback, // it ends the run
  interrupted, // a signal has come
  slow,     // Newton fails so often that the end is far away
  started,  // the velocities of the history have to be made consistent
  failed,   // there is no further step
  no_start  // the run cannot start, or start again
};

inline const char *name_of(Reason reason) {
  static constexpr const char *names[] = {"end",         "event", "rows",    "steps",  "callback",
                                          "interrupted", "slow",  "started", "failed", "no_start"};
  return names[static_cast<int>(reason)];
}

// What was made since Python has read it last: the number of steps, rows, and polynomials from `starts` to `ends`.
template <class Curve> struct Made {
  long steps = 0;
  std::vector<double> t, p, v, lam;
  std::vector<int> order; // of the step that leads to a row; 0 in a start, and after a jump at the same time
  Curve curve;
  std::vector<double> starts, ends;
};

// What is asked of a call: whether polynomials are kept, events, what is called with each step, and what gives the times at
// which forces jump; None if there are none.
struct Asked {
  bool with_curve = false;
  Events *events = nullptr;
  const nb::object &sees, &forces;
};

// The accuracy, s, of a time.
inline double exactly(double t) { return 4e-16 * std::max(1.0, std::abs(t)); }

// An interval of time and the values of an event's function at its ends.
struct Bracket {
  double begin, before, end, after;
};

// Shorten an interval until g has its sign before the zero at the beginning too; false if it never has.
template <class G> bool narrowed(const G &g, Bracket &of) {
  const double left = of.begin;
  while (std::abs(of.end - left) > shortest_step(of.end)) {
    const double t = left + SHORTER * (of.end - left), value = g(t);
    if (value * of.before > 0.0) {
      of.begin = t;
      of.before = value;
      return true;
    }
    of.end = t;
    of.after = value;
  }
  return false;
}

// The zero of g between a and b, where its signs differ, and its value there. By inverse quadratic interpolation or
// bisection, chosen as by Chandrupatla (Adv. Eng. Softw. 28, 1997); if that takes long, by bisection alone.
template <class G> std::pair<double, double> zero(const G &g, double a, double fa, double b, double fb, double near) {
  double part = fa / (fa - fb);
  if (std::isnan(part)) part = 0.5; // infinite values
  for (int tries = 1;; ++tries) {
    const double least = 0.5 * near / std::abs(b - a);
    const double t = a + std::min(std::max(part, least), 1.0 - least) * (b - a), f = g(t);
    double c = a, fc = fa;
    if (!(f * fa > 0.0)) {
      std::swap(c, b);
      std::swap(fc, fb);
    }
    a = t;
    fa = f;
    if (fa == 0.0 || std::abs(b - a) <= near) break;
    const double x = (a - b) / (c - b), y = (fa - fb) / (fc - fb);
    part = tries < HALVING && y * y < x && (1.0 - y) * (1.0 - y) < 1.0 - x
               ? fa / (fa - fb) * fc / (fc - fb) - (c - a) / (b - a) * fa / (fc - fa) * fb / (fb - fc)
               : 0.5;
  }
  return std::abs(fa) < std::abs(fb) ? std::pair{a, fa} : std::pair{b, fb};
}

// Method has `advance`, `prepare_next`, `shorten`, `order`, `velocity`, `multipliers`, `keep`, `looks`, `look`, `control`,
// `inside`, `locate`, `end_at`, `start`, `resume`, `jump`.
template <class Method, class Curve> class Run {
public:
  // The state of the run: time reached, next step and the one before, position.
  double t = 0.0, h = 0.0, used_h = 0.0;
  Vec p;
  Mat turns;
  double first = 0.0; // size of the first step; 0 if it is chosen
  // For fixed steps: their wanted size, where they begin, how many were made, and of how many.
  double step = 0.0, start_time = 0.0;
  long taken = 0, steps = 0;
  bool moving = false; // constraints may depend on time
  bool waits = false;  // return after a start, whose velocities have to be made consistent

  Made<Curve> output;
  std::optional<Hit> hit;
  Failure failure = Failure::none;
  double singular_at = 0.0; // for Failure::singular_between
  double to_come = 0.0;     // steps up to the end, for Reason::slow
  // The last step: its end, size and order.
  double reached = 0.0, reached_by = 0.0;
  int reached_order = 0;

  // Divide the time up to `t_end` into fixed steps of the wanted size or slightly smaller, and at least so many.
  void divide(double t_end, long least = 1) {
    steps = std::max(least, std::lround(std::ceil(std::abs(t_end - t) / step - 1e-9)));
    start_time = t;
    taken = 0;
    h = (t_end - t) / steps;
  }

  // Rows are wanted at these times, in their order, instead of at the ends of all steps; `exact`: steps end there.
  void ask_rows(std::vector<double> times, bool exact) {
    due_ = std::move(times);
    next_due_ = 0;
    at_times_ = true;
    exact_ = exact;
  }

  // After every so many steps, look whether the rows kept are a poor choice.
  void watch_rows(KeptRows *rows, int every) {
    rows_ = rows;
    rows_every_ = every;
  }

  // Start, or start again, at a state with its acceleration and multipliers, when the loop is entered.
  void begin_at(double t0, const Vec &p0, const Vec &v0, const Vec &a0, const Vec &lam0) {
    t = reached = t0;
    p = p0;
    begin_ = {t0, p0, v0, lam0};
    begin_a_ = a0;
    begins_ = true;
  }

  // Continue from where the last call has ended, with other forces, or to another end.
  void resume_here() { resumes_ = !begins_; }

  // The states of a start: where it began, and those that the loop has not left yet.
  std::vector<Located> history() const {
    std::vector<Located> all{begin_};
    all.insert(all.end(), started_.begin(), started_.end());
    return all;
  }

  // Take over the state of a run with other rows of the constraints.
  template <class Other> void take_over(const Other &before) {
    self().stand(before.t, before.h, before.p, before.velocity(), Vec::Zero(system_.nc));
    std::tie(due_, next_due_, at_times_, exact_) = std::tie(before.due_, before.next_due_, before.at_times_, before.exact_);
    std::tie(window_steps_, window_failed_, window_t_) = std::tie(before.window_steps_, before.window_failed_, before.window_t_);
    reached = before.reached;
  }

  // Make steps towards t_end, at most so many; forces have `jumped` since the last call.
  Reason run(double t_end, long most, const Asked &asked, bool jumped) {
    const auto called = std::chrono::steady_clock::now();
    const long last = output.steps + most;
    failure = Failure::none;
    hit.reset();
    ended_ = false;
    if (jumped && !jump_here(asked)) return Reason::failed;
    if (hit) return Reason::event;
    if (t == t_end) return Reason::end;
    double until = next_until(asked, t_end);
    while (true) {
      if (!entered(until)) return Reason::no_start;
      if (waits && std::exchange(has_started_, false)) return Reason::started;
      const bool done = started_.empty() ? one_step(until, asked) : leave_started(last, asked);
      if (!done) return Reason::failed;
      if (hit) return Reason::event;
      if (ended_) return Reason::callback;
      if (interrupted(asked)) return Reason::interrupted;
      if (started_.empty()) {
        if (t == t_end) return Reason::end;
        if (t == until) {
          if (!change(asked)) return Reason::failed;
          if (hit) return Reason::event;
          if (fixed()) resumes_ = !begins_; // the time up to the next end is divided
          until = next_until(asked, t_end);
        }
        if (rows_ && ++since_rows_ >= rows_every_ && std::exchange(since_rows_, 0) && rows_->poor(p)) return Reason::rows;
        if (is_slow(t_end)) return Reason::slow;
      }
      if (output.steps >= last) return Reason::steps;
      if (std::chrono::steady_clock::now() - called > std::chrono::duration<double>(LONGEST_CALL)) return Reason::steps;
    }
  }

protected:
  // What later steps depend on.
  auto lasting_of_run() {
    return std::tie(t, h, used_h, p, first, taken, reached, reached_by, reached_order, begun_, begins_, resumes_, has_started_,
                    headway_, window_steps_, window_failed_, window_t_);
  }

  explicit Run(System &system) : system_(system), index1_(system) {}

  bool begun_ = false;           // the run has begun before
  std::vector<Located> started_; // states of a start that the loop has not left yet

  bool fixed() const { return static_cast<const Method &>(*this).control.fixed(); }

  // The time of the next step; the last steps of a variable run are fitted to the end.
  double next_time(double t_end) {
    if (fixed()) return taken + 1 < steps ? start_time + (taken + 1) * h : t_end;
    const double left = (t_end - t) / h;
    if (left >= 2.0) return t + h;
    const bool last = left < 1.0 + 1e-9;
    self().shorten((t_end - t) / (last ? 1 : 2)); // two equal steps avoid a tiny last one
    return last ? t_end : t + h;
  }

  System &system_;
  Headway headway_;
  Projection index1_;

private:
  template <class, class> friend class Run;

  Method &self() { return static_cast<Method &>(*this); }

  // Signals are noticed after each step where it has called users' functions.
  static bool interrupted(const Asked &asked) {
    if (!asked.events) return false;
    nb::gil_scoped_acquire holds;
    return asked.events->interrupted();
  }

  // Where the next step has to end at the latest.
  double next_until(const Asked &asked, double t_end) const {
    const bool stops = exact_ && next_due_ < due_.size() && std::abs(due_[next_due_] - t) < std::abs(t_end - t);
    const double stop = stops ? due_[next_due_] : t_end;
    if (asked.forces.is_none()) return stop;
    nb::gil_scoped_acquire holds;
    return nb::cast<double>(asked.forces.attr("next_change")(t, stop));
  }

  // Start, or start again, if that is due; false if it fails.
  bool entered(double until) {
    if (begins_) {
      begins_ = resumes_ = false;
      has_started_ = true;
      const bool again = begun_;
      failure = self().start(begin_, begin_a_, until);
      if (!again) restart_pace();
    } else if (std::exchange(resumes_, false)) {
      has_started_ = true;
      failure = self().resume(until);
    }
    return failure == Failure::none;
  }

  // A step, up to an event that changes the run.
  bool one_step(double until, const Asked &asked) {
    const double before = t;
    const long failed = self().control.rejected_by_newton;
    self().prepare_next();
    failure = self().advance(until);
    if (failure != Failure::none) return false;
    ++window_steps_;
    window_failed_ += self().control.rejected_by_newton - failed;
    if (asked.events && !search_step(*asked.events)) return false;
    if (hit) self().end_at(hit->at.t);
    if (asked.with_curve) keep(before, hit ? hit->at.t : t);
    if (!add_rows(hit ? hit->at.t : t)) return false;
    leave(hit ? hit->at : Located{t, p, self().velocity(), self().multipliers()}, self().order(), asked);
    return true;
  }

  // Leave the states of a start, up to an event that changes the run.
  bool leave_started(long last, const Asked &asked) {
    if (asked.with_curve) keep(reached, reached);
    size_t n = 0;
    while (n < started_.size() && output.steps < last && !hit && !ended_) {
      const Located state = started_[n++];
      if (asked.events && !search_started(*asked.events, state)) return false;
      const Located &at = hit ? hit->at : state;
      if (asked.with_curve) output.ends.back() = at.t;
      if (!add_rows(at.t)) return false;
      leave(at, 0, asked);
    }
    if (hit) n = started_.size();
    started_.erase(started_.begin(), started_.begin() + n);
    return true;
  }

  void keep(double start, double end) {
    self().keep(output.curve);
    output.starts.push_back(start);
    output.ends.push_back(end);
  }

  // The rows that are due, up to a time in the last step; false if the equations are singular at one.
  bool add_rows(double end) {
    const double sign = end >= reached ? 1.0 : -1.0;
    for (; next_due_ < due_.size() && sign * (due_[next_due_] - end) <= 0.0; ++next_due_) {
      const auto row = self().inside(due_[next_due_]);
      if (!row) return is_singular(due_[next_due_]);
      add_row(*row, 0);
    }
    return true;
  }

  bool is_singular(double at) {
    singular_at = at;
    failure = Failure::singular_between;
    return false;
  }

  void add_row(const Located &row, int order) {
    output.t.push_back(row.t);
    output.order.push_back(order);
    put(output.p, row.p);
    put(output.v, row.v);
    put(output.lam, row.lam);
  }

  // The end of a step.
  void leave(const Located &at, int order, const Asked &asked) {
    ++output.steps;
    reached_by = std::abs(at.t - reached);
    reached = at.t;
    reached_order = order;
    if (!at_times_) add_row(at, order);
    if (asked.sees.is_none()) return;
    nb::gil_scoped_acquire holds;
    ended_ = nb::cast<bool>(asked.sees(at.t, array(at.p), array(at.v), array(at.lam), order));
  }

  // A second row at the time reached; of rows at given times the only one.
  void add_jump() {
    const Located here{t, p, self().velocity(), self().multipliers()};
    if (!at_times_) return add_row(here, 0);
    if (output.t.empty() || output.t.back() != t) return;
    output.t.pop_back();
    output.order.pop_back();
    output.p.resize(output.p.size() - here.p.size());
    output.v.resize(output.v.size() - here.v.size());
    output.lam.resize(output.lam.size() - here.lam.size());
    add_row(here, 0);
  }

  // The first event of the last step that changes the run; false if the equations are singular at one.
  bool search_step(Events &events) {
    nb::gil_scoped_acquire holds; // once for all looks
    unseen_ = self().looks();
    events.begin_step();
    while (true) {
      if (!look_on(events)) return is_singular(events.end);
      if (!events.changed) return true;
      if (!locate_in(events)) return false;
      if (hit) return true;
    }
  }

  // Up to a state of a start.
  bool search_started(Events &events, const Located &state) {
    nb::gil_scoped_acquire holds;
    if (events.at_zero()) {
      const auto beside = self().inside(events.end + AFTER_ZERO * (state.t - events.end));
      if (events.look(beside->t, beside->p, beside->v, beside->lam) && !locate_in(events)) return false;
      if (hit) return true;
    }
    return !events.look(state.t, state.p, state.v, state.lam) || locate_in(events);
  }

  bool locate_in(Events &events) {
    const auto locate = [&](size_t i, double limit) { return self().locate(events, i, limit); };
    return events.search(locate, hit) || is_singular(events.end);
  }

  // Evaluate the events in the unseen part of the last step, until one has changed.
  bool look_on(Events &events) {
    events.changed = false;
    while (unseen_ > 0 && !events.changed) {
      const double at = t - used_h * (unseen_ - 1) / self().looks();
      if (events.at_zero() && !self().look(events, events.end + AFTER_ZERO * (at - events.end))) return false;
      if (events.changed) break;
      --unseen_;
      if (!self().look(events, at)) return false;
      const double between = events.changed ? NOT_A_NUMBER : events.doubtful();
      if (std::isnan(between)) continue;
      events.back();
      if (!self().look(events, between)) return false;
      if (events.changed) ++unseen_;
      else if (!self().look(events, at)) return false;
    }
    return true;
  }

  // Forces may jump here: the state stays the same, and the multipliers jump with the forces. If neither they nor their
  // rates do, the run goes on.
  bool change(const Asked &asked) {
    if (asked.forces.is_none()) return true;
    nb::gil_scoped_acquire holds;
    const nb::object changed = asked.forces.attr("change")(t, array(p), array(Vec(self().velocity())));
    if (changed.is_none()) return true;
    resumes_ = true;
    if (!nb::cast<bool>(changed)) return true;
    if (moving && !push(asked)) return false;
    return jump_here(asked);
  }

  // Where rates of constraints jump, too, the run starts again from the velocities projected onto the new rates: the effect
  // of an impulse along the constraints.
  bool push(const Asked &asked) {
    const Vec v = self().velocity();
    system_.constraint(t, p, v);
    if (largest(system_.phi) > JUMP_GAP * (1.0 + largest(p))) return fails(Failure::constraint_jumps);
    const State after = index1_.project(t, p, v);
    if (*after.failure) return fails(Failure::singular);
    if (largest(Vec(after.v - v)) <= PUSHED * (1.0 + largest(v))) return true;
    Vec a, lam;
    if (!index1_.acceleration(t, after.p, after.v, a, lam)) return fails(Failure::singular);
    begin_at(t, after.p, after.v, a, lam);
    self().stand(t, h, after.p, after.v, lam);
    add_jump();
    if (asked.events) asked.events->restart(t, after.p, after.v, lam);
    return true;
  }

  bool fails(Failure why) {
    failure = why;
    return false;
  }

  bool jump_here(const Asked &asked) {
    if (begins_) return true;
    failure = self().jump();
    if (failure != Failure::none) return false;
    resumes_ = true;
    add_jump();
    if (!asked.events) return true;
    nb::gil_scoped_acquire holds;
    hit = asked.events->jumped({t, p, self().velocity(), self().multipliers()});
    return true;
  }

  // Whether the run would not end in reasonable time because Newton fails again and again. With a relay that switches
  // against the motion no step of useful length has a solution. Long runs and steep forces alone are no reason to stop.
  bool is_slow(double t_end) {
    if (window_steps_ < WINDOW || fixed()) return false;
    const double gone = std::abs(t - window_t_);
    to_come = gone ? window_steps_ * std::abs(t_end - t) / gone : INF;
    const bool slow = window_failed_ > CHATTER * window_steps_ && to_come > TOO_MANY;
    restart_pace();
    return slow;
  }

  void restart_pace() {
    window_steps_ = window_failed_ = 0;
    window_t_ = t;
  }

  Located begin_; // where the run starts when the loop is entered
  Vec begin_a_;
  bool begins_ = false, resumes_ = false, has_started_ = false, ended_ = false;
  int unseen_ = 0; // remaining evaluations of events in the last step
  std::vector<double> due_; // times of rows
  size_t next_due_ = 0;
  bool at_times_ = false, exact_ = false;
  KeptRows *rows_ = nullptr;
  int rows_every_ = 1, since_rows_ = 0;
  long window_steps_ = 0, window_failed_ = 0;
  double window_t_ = 0.0;
};

} // namespace pinconsist
