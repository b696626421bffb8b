// A run of Radau IIA.
#pragma once

#include "collocation.hpp"
#include "radau.hpp"
#include "run.hpp"

namespace pinconsist {

class RadauStepper : public Run<RadauStepper, Collocations> {
public:
  int used_s = 0;
  Vec v, a, lam;
  RadauControl control;
  StageNewton newton;

  RadauStepper(System &system, const Switches &switches)
      : Run(system), newton(system, switches), switches_(switches), sampler(system), kkt_(system.nv, system.nc), within_(system.nv, system.nc),
        stiff_forces_(system) {}

  // What later steps depend on, besides the system, switches and `turns`.
  auto lasting() {
    return std::tuple_cat(lasting_of_run(), std::tie(used_s, v, a, lam, control, slope_, stage_a_, shaped_, shape_), newton.lasting());
  }

  // A first step with error FIRST_ERROR, from the time in which the acceleration changes by its own size.
  double first_step(double t_end) {
    const double limit = std::abs(t_end - t), tiny = 1e-300, near = FIRST_REACH * (1.0 + largest(p));
    weights();
    const auto size = [&](const Vec &x) {
      return std::sqrt(x.cwiseProduct(weight_.tail(system_.nv)).squaredNorm() / system_.nv);
    };
    double trial = std::min({limit, near / std::max(largest(v), tiny), std::sqrt(near / std::max(largest(a), tiny))});
    double change, most; // of the acceleration over the trial, and its largest size
    const auto tells = [&] {
      const double step = std::copysign(trial, t_end - t);
      v1_ = v + step * a;
      shift_ = step * system_.rate(t, p, 0.5 * (v + v1_));
      system_.integrate(p, shift_, p1_);
      change = INF;
      most = 1.0;
      if (!index1_.acceleration(t + step, p1_, v1_, a1_, lam1_) || !a1_.allFinite() || !lam1_.allFinite()) return false;
      change = size(a1_ - a);
      most = std::max(size(a), size(a1_));
      const bool from_zero = size(a) <= FIRST_CHANGE * most && change * trial <= FIRST_CHANGE * size(v);
      if (from_zero) most = std::sqrt(change / trial * size(v)); // reached while it changes the velocity by its own size
      return from_zero || change * trial <= FIRST_ERROR || change <= FIRST_CHANGE * most;
    };
    for (int i = 1; !tells() && i < static_cast<int>(FIRST_TRIALS); ++i) trial *= 0.25;
    if (std::isfinite(change)) slope_ = (a1_ - a) / std::copysign(trial, t_end - t);
    const double time = std::min(limit, trial * most / std::max(change, tiny));
    const double part = std::pow(FIRST_ERROR / std::max(most * time, tiny), 1.0 / control.exponent());
    const double least = change * trial <= FIRST_ERROR ? trial : 0.0; // as at rest, where accelerations are rounding
    const double found = std::min(std::max(time * std::min(1.0, part), least), control.max_step);
    return std::copysign(std::max({found, shortest_step(t), shortest_step(t_end)}), t_end - t);
  }

  // A state of the run, up to the next start.
  void stand(double t0, double size, const Vec &p0, const Vec &v0, const Vec &lam0) {
    t = t0;
    h = size;
    p = p0;
    v = v0;
    lam = lam0;
    begun_ = true;
  }

  // Start, or start again, at a state on the constraints with its acceleration and multipliers.
  void begin_anew(double t0, const Vec &p0, const Vec &v0, const Vec &a0, const Vec &lam0, double t_end) {
    t = t0;
    p = p0;
    v = v0;
    a = a0;
    lam = lam0;
    used_h = 0.0;
    used_s = 0;
    last_.reset();
    accurate_.reset();
    control.restart();
    newton.forget();
    remembered_ = 0;
    slope_.setZero(system_.nv);
    stage_a_ = a;
    headway_.restart(t, t);
    shaped_ = false;
    if (fixed()) {
      divide(t_end);
    } else if (first != 0.0) {
      h = std::copysign(std::min({first, std::abs(t_end - t), control.max_step}), t_end - t);
    } else {
      const double careful = first_step(t_end), before = begun_ ? std::abs(h) : 0.0;
      h = std::copysign(std::min(std::max(std::abs(careful), before), RESTARTED * std::abs(careful)), careful);
    }
    begun_ = true;
  }

  // Forces have jumped: the accelerations that start Newton's iteration change by the same amount.
  Failure jump() {
    moved_ = a;
    remembered_ = 0;
    if (!index1_.acceleration(t, p, v, a, lam)) return Failure::singular;
    if (!a.allFinite() || !lam.allFinite()) return newton.not_finite(t, p, v);
    stage_a_ += a - moved_;
    if (!shaped_) return Failure::none;
    for (Vec *each : {&shape_.start, &shape_.end}) *each += a - moved_;
    shape_.W.colwise() += a - moved_;
    return Failure::none;
  }

  Failure start(const Located &from, const Vec &a0, double until) {
    begin_anew(from.t, from.p, from.v, a0, from.lam, until);
    return Failure::none;
  }

  Failure resume(double until) {
    if (fixed()) divide(until);
    return Failure::none;
  }

  // A state within the last step; nothing if the equations are singular there.
  std::optional<Located> inside(double at) {
    if (at == t) return Located{t, p, v, lam};
    if (!sampler.sample(accurate(), at)) return {};
    return Located{at, sampler.p, sampler.v, sampler.lam};
  }

  // Repeat a step up to another end; null if it fails.
  Collocations::value_type retake(const Collocation &step, double t_end) {
    return remade(step.shape, step.shape.t, t_end, step.p0, step.v0, step.shape.start);
  }

  // An event between the last two evaluations of the events: its time and state, at the end of a step that is repeated up to
  // there, so that the function is zero to rounding. Nothing if the equations are singular there. With a `limit`, of a function
  // whose sign has changed there already, in a step that ends there: long steps are less accurate between their ends.
  std::optional<Located> locate(Events &events, size_t i, double limit = NOT_A_NUMBER) {
    if (events.values[i] == 0.0 && events.end == t && std::isnan(limit)) return Located{t, p, v, lam};
    bool regular = true;
    const auto g = [&](const Collocations::value_type &of, double at) {
      regular = regular && sampler.look(of, at, events.with_multipliers());
      return regular ? events.value(i, at, sampler.p, sampler.v, sampler.lam) : 0.0;
    };
    auto step = last_step();
    Bracket between{events.begin, events.before[i], events.end, events.values[i]};
    if (!std::isnan(limit)) {
      const auto shorter = retake(*step, limit);
      if (shorter) step = shorter;
      between.end = limit;
      between.after = g(step, limit);
      if (between.before * between.after > 0.0) return {};
    }
    const bool leaves = events.leaves(i);
    const auto search = [&](double &root) {
      if (leaves && !narrowed([&](double at) { return g(step, at); }, between)) return false;
      const auto &[begin, before, end, after] = between;
      const double near = std::max(exactly(end), ROUGHLY * std::abs(end - begin));
      root = after == 0.0 ? end : zero([&](double at) { return g(step, at); }, begin, before, end, after, near).first;
      return true;
    };
    double root = between.begin;
    const bool found = search(root);
    const double start = step->shape.t, last = std::isnan(limit) ? t : limit;
    // A Newton step, not far from there; NaN if there is none.
    const auto better = [&](double there) {
      const double beside = root - SLOPE_OVER * (root - between.begin);
      const double moved = root - there * (root - beside) / (there - g(step, beside));
      const bool near = std::abs(moved - root) <= std::abs(events.end - events.begin);
      return near && (moved - start) * (moved - last) < 0.0 ? moved : NOT_A_NUMBER;
    };
    double least = INF;
    for (int turn = 0; turn < RELOCATED && found && regular && std::abs(root - start) >= shortest_step(root); ++turn) {
      const auto ending = ending_at(step, root);
      const double there = ending ? g(ending, root) : NOT_A_NUMBER;
      const bool late = leaves && there * between.after > 0.0;
      if (!late && !(std::abs(there) < least)) break;
      step = ending;
      const double before = root;
      if (late) { // just after a start the polynomial of a long step has not the rates of the start: shorter steps have
        between = {events.begin, events.before[i], root, there};
        if (!search(root)) break;
      } else {
        least = std::abs(there);
        const double moved = better(there);
        if (std::isnan(moved)) break;
        root = moved;
      }
      if (std::abs(root - before) <= ROUGHLY * std::abs(before - start)) break;
    }
    if (!regular || !sampler.sample(step, root)) return {};
    for (int turn = 0; turn < RELOCATED && found; ++turn) { // the polynomial is exact so near to its end
      const Located here{root, sampler.p, sampler.v, sampler.lam};
      const double there = events.value(i, root, here.p, here.v, here.lam), moved = better(there);
      const bool moves = std::abs(moved - root) > exactly(root) && regular && sampler.sample(step, moved);
      if (!moves || !(std::abs(events.value(i, moved, sampler.p, sampler.v, sampler.lam)) < std::abs(there))) {
        endings_.push_back({root, step});
        return here;
      }
      root = moved;
    }
    endings_.push_back({root, step});
    return Located{root, sampler.p, sampler.v, sampler.lam};
  }

  // Let the last step end at an event that was located.
  void end_at(double at) {
    for (const auto &[time, step] : endings_) {
      if (time != at) continue;
      last_ = step;
      accurate_.reset();
    }
  }

  // Repeat a step up to an event; null if it fails, or its stages have converged to another motion, as they may where friction
  // changes its direction.
  Collocations::value_type ending_at(const Collocations::value_type &step, double root) {
    const auto ending = retake(*step, root);
    if (!ending || !sampler.look(step, root, false)) return nullptr;
    const double apart = weighted_norm(Vec(ending->v1 - sampler.v), Vec(weight_.tail(system_.nv)), system_.nv);
    return apart <= ASTRAY ? ending : nullptr;
  }

  // Results of the last step.
  const Collocations::value_type &last_step() {
    if (!last_) last_ = made(shape_, p, v);
    return last_;
  }

  // A step that was made, of which linearisations need the start and the accelerations.
  struct Taken {
    const RadauTable *table;
    double t, h;
    Vec p, v;
    Mat W;
  };
  // The steps since a time; none if a force has jumped since then, or if they are too many.
  std::vector<const Taken *> steps_since(double from) const {
    std::vector<const Taken *> found;
    for (size_t k = remembered_; k > 0 && found.size() < REMEMBERED; --k) {
      found.push_back(&remembered_steps_[(k - 1) % REMEMBERED]);
      if (found.back()->t != from) continue;
      std::reverse(found.begin(), found.end());
      return found;
    }
    return {};
  }

  const Vec &velocity() const { return v; }
  const Vec &multipliers() const { return lam; }

  Sampler sampler;

  // The last step, with its halves where its polynomial is not accurate enough between the ends. Another stepper makes
  // them, so that the run does not depend on who looks inside its steps.
  const Collocations::value_type &accurate() {
    if (!accurate_) accurate_ = with_halves(last_step());
    return accurate_;
  }

  Collocations::value_type with_halves(const Collocations::value_type &step) {
    if (fixed()) return step;
    weights();
    shift_ = control.slack() * weight_.tail(system_.nv);
    if (sampler.error_between(step, shift_) <= BETWEEN) return step;
    if (!halving_) halving_ = std::make_unique<RadauStepper>(system_, switches_);
    halving_->control = control;
    const auto halved = halving_->halved(*step);
    for (auto count : {&StageNewton::nfev, &StageNewton::njev, &StageNewton::nlu})
      newton.*count += std::exchange(halving_->newton.*count, 0);
    return halved ? halved : step;
  }

  void prepare_next() {
    if (fixed() || !turns.rows()) return;
    const double speed = bdf::fastest_turn(turns, system_.rate(t, p, v));
    if (speed != 0.0) shorten(std::copysign(std::min(std::abs(h), MAX_CHART_TURN / speed), h));
  }

  // One accepted step towards t_end.
  Failure advance(double t_end) {
    control.reached(system_, p, v);
    double t_next, error, smaller, wanted;
    while (true) {
      wanted = h;
      t_next = next_time(t_end);
      if (t_next == t) return Failure::error_test;
      Failure failure = solve(t_next);
      if (failure == Failure::none) failure = land(t_next, error);
      if (failure == Failure::none) {
        if (error <= 1.0) break;
        smaller = control.after_rejection(h, error);
        keep_shape(newton.stages.W.rightCols(1));
      } else {
        if (fixed()) return failure;
        smaller = control.after_failure(h);
      }
      if (failure != Failure::none || std::abs(smaller) <= MIN_FACTOR * std::abs(h)) {
        control.choose_after_failure();
        shaped_ = false; // the stages may have converged to another closed position
        slope_.setZero();
      }
      if (headway_.setback() || std::abs(smaller) < shortest_step(t))
        return failure != Failure::none ? failure : Failure::error_test;
      h = smaller;
    }
    keep_shape(a1_);
    last_.reset();
    accurate_.reset();
    endings_.clear();
    system_.step_ended(v1_);
    stage_a_ = newton.stages.W.rightCols(1);
    newton.accepted();
    used_h = newton.stages.h;
    used_s = control.s;
    remember();
    t = t_next;
    std::swap(p, p1_);
    std::swap(v, v1_);
    std::swap(a, a1_);
    std::swap(lam, lam1_);
    ++taken;
    if (!fixed()) {
      const bool cut = h != wanted;
      h = control.next_step(newton.stages.h, error);
      control.choose_after_step(cut);
    }
    headway_.reached(t);
    return Failure::none;
  }

private:
  // A step within another one, from a state and its acceleration; null if it fails.
  Collocations::value_type remade(const Shape &guess, double t0, double t_end, const Vec &p0, const Vec &v0, const Vec &a0) {
    place(guess.table->s, t0, t_end - t0, p0, v0);
    guess.predict(newton.stages);
    newton.forget(); // the last step did not end where this one starts
    const double tol = control.weights(system_, p0, v0, weight_);
    double error;
    if (newton.solve(weight_, tol) != Failure::none) return nullptr;
    if (land(t_end, error, false) != Failure::none) return nullptr;
    newton.forget();
    return made(solved_shape(a0, a1_), p1_, v1_);
  }

  Collocations::value_type halved(const Collocation &step) {
    const Shape &of = step.shape;
    const double middle = of.t + 0.5 * of.h;
    const auto first = retake(step, middle);
    const auto second = first ? remade(of, middle, of.t + of.h, first->p1, first->v1, first->shape.end) : nullptr;
    if (!second) return nullptr;
    Collocation to_end = *second, halved = step;
    to_end.p1 = step.p1;
    to_end.v1 = step.v1;
    halved.halves[0] = first;
    halved.halves[1] = std::make_shared<Collocation>(to_end);
    return std::make_shared<Collocation>(halved);
  }

  friend class Run<RadauStepper, Collocations>;

  // The stages of a step to t_next.
  Failure solve(double t_next) {
    const int s = control.s;
    place(s, t, t_next - t, p, v);
    if (shaped_) shape_.predict(newton.stages);
    else newton.stages.W = a.replicate(1, s) + slope_ * (newton.stages.h * newton.stages.table->c.transpose());
    const double tol = weights();
    const Failure failure = newton.solve(weight_, tol, switches_.kept_matrix && !fixed());
    if (failure != Failure::none) return failure;
    for (int i = 0; i < s && turns.rows(); ++i)
      if (bdf::fastest_turn(turns, newton.stages.xi.col(i)) > MAX_CHART_TURN) return Failure::turns_too_far;
    return Failure::none;
  }

  void place(int number, double t0, double step, const Vec &p0, const Vec &v0) {
    const RadauTable &table = RadauTable::of.at(number);
    if (newton.stages.table != &table) newton.use(table);
    newton.stages.t = t0;
    newton.stages.h = step;
    newton.stages.p = p0;
    newton.stages.v = v0;
  }

  // With the accelerations at its ends.
  Shape solved_shape(const Vec &start, const Vec &end) const {
    const Stages &of = newton.stages;
    return {of.table, of.t, of.h, of.W, start, end};
  }
  void keep_shape(const Vec &end) {
    const Stages &of = newton.stages; // assigned one by one: nothing is allocated
    shaped_ = true;
    shape_.table = of.table;
    shape_.t = of.t;
    shape_.h = of.h;
    shape_.W = of.W;
    shape_.start = a;
    shape_.end = end;
  }

  // Results of a step that ends at this state.
  Collocations::value_type made(const Shape &shape, const Vec &p1, const Vec &v1) const {
    const Stages &of = newton.stages;
    return std::make_shared<Collocation>(Collocation{shape, of.U(), of.p, of.v, p1, v1, has_stiff_forces_});
  }

  double weights() { return control.weights(system_, p, v, weight_); }

  // The end of a step: one factorisation at the last stage serves the projections and the error estimate.
  Failure land(double t_next, double &error, bool with_error = true) {
    const int nv = system_.nv, nc = system_.nc, last = newton.stages.size() - 1;
    const int modes = fixed() || !with_error ? 0 : last < 2 ? 1 : 6;
    const double t1 = newton.stages.time(last);
    p1_ = newton.stages.P.col(last);
    v1_ = newton.stages.V.col(last);
    ++newton.nlu;
    estimate(modes);
    rhs_.setZero(nv + nc, 2);
    all_rhs_.setZero(nv + nc, 2 + modes);
    bool closed = false, moved = false;
    for (int turn = 0; turn < static_cast<int>(CLOSINGS) && !closed; ++turn) {
      system_.constraint(t1, p1_, v1_);
      closed = largest(system_.phi) <= GAP_LEFT * (1.0 + largest(p1_));
      rhs_.leftCols(2).setZero();
      rhs_.col(0).tail(nc) = system_.rho;
      rhs_.col(1).tail(nc) = system_.phi;
      if (turn == 0) {
        system_.mass_matrix(t1, p1_, v1_, kkt_.A());
        all_rhs_.leftCols(2) = rhs_;
        for (int m = 0; m < modes; ++m) all_rhs_.col(2 + m).tail(nc) = system_.W.lazyProduct(modes_.col(m));
        if (!kkt_.solve_new(system_.W, system_.G_transposed(), 1.0, all_rhs_)) return Failure::singular;
        for (int m = 0; m < modes && nc < nv; ++m) modes_.col(m) -= all_rhs_.col(2 + m).head(nv);
        rhs_ = all_rhs_.leftCols(2);
      } else {
        kkt_.solve(rhs_, 1.0);
      }
      v1_ -= rhs_.col(0).head(nv);
      if (closed) break;
      shift_ = -system_.moved_by(t1, p1_, v1_, rhs_.col(1).head(nv));
      system_.integrate(p1_, shift_, moved_);
      std::swap(p1_, moved_);
      if (!p1_.allFinite()) return Failure::not_converged;
      moved = true;
    }
    if (!closed) {
      system_.constraint(t1, p1_, v1_);
      if (largest(system_.phi) > rounding_gap(p1_, system_.G_transposed())) return Failure::not_converged;
    }
    undo_projection();
    error = modes ? error_of(modes) : 0.0;
    if (error > 1.0) return Failure::none; // a and λ are not needed
    const KKT *known = moved || !system_.rate_is_velocity ? nullptr : &kkt_; // otherwise W depends on v
    return index1_.acceleration_after_constraint(t_next, p1_, v1_, a1_, lam1_, known) ? Failure::none : Failure::singular;
  }

  // Take back what the projection of the velocity v1_ has moved along stiff forces.
  void undo_projection() {
    const int nv = system_.nv, nc = system_.nc;
    has_stiff_forces_ = false;
    if (!nc || nc == nv) return;
    const auto weight = weight_.tail(nv);
    const auto [M, D, K] = newton.at_end();
    stiff_forces_.set(D, K, newton.stages.h);
    shift_ = v1_ - newton.stages.V.rightCols(1);
    const auto size = [&](const auto &x) { return x.cwiseProduct(weight).norm(); };
    has_stiff_forces_ = size(stiff_forces_.effect(kkt_, shift_)) > STIFF_PART * size(shift_);
    if (has_stiff_forces_) stiff_forces_.take_back(M, shift_, v1_);
  }

  // The data of the error estimate: the highest modes of the accelerations, and the differences of the acceleration at
  // the start from their polynomial and from the last stage of the previous step.
  void estimate(int modes) {
    const Mat &W = newton.stages.W, &of = newton.stages.table->modes;
    const int s = newton.stages.size();
    modes_.resize(system_.nv, modes);
    if (!modes) return;
    modes_.col(modes == 1 ? 0 : 4) = W.lazyProduct(newton.stages.table->at_start) - a;
    if (modes == 1) return; // the degree is raised by it
    combine(W, of, coefficients_);
    modes_.col(3).setZero(); // three stages have no fourth mode
    for (int m = 0; m < std::min(s, 4); ++m) modes_.col(m) = coefficients_.col(s - 1 - m);
    modes_.col(5) = stage_a_ - a;
  }

  double error_of(int modes) {
    if (modes == 1) {
      const Stages &of = newton.stages;
      if (of.size() == 1 && system_.nc == system_.nv) modes_.col(0) = (v1_ - of.v) / of.h - a; // v is exact now
      return size_of(0);
    }
    constexpr double tiny = 1e-300;
    const double middle = size_of(1), before = size_of(2), step = newton.stages.h;
    double highest = size_of(0), upper, lower; // a single mode may pass through zero, two rarely do so together
    if (newton.stages.size() > 3) {
      upper = std::hypot(highest, middle);
      lower = std::hypot(before, size_of(3));
    } else {
      upper = highest = std::max(highest, middle * middle / std::max({middle, before, tiny}));
      lower = before;
    }
    const double decay = upper / (lower + tiny); // over two degrees
    highest = std::max(highest, std::sqrt(std::min(decay, 1.0)) * middle);
    const RadauTable &table = *newton.stages.table;
    const double beside = size_of(4), earlier = size_of(5);
    const bool crossing = crosses();
    const auto left = [&](double noise) { // the error that is not rounding, if this is the rounding of the highest mode
      const double at_start = noise * table.starting / table.leading;
      const double last = std::sqrt(std::max(highest * highest - noise * noise, 0.0));
      const double missed = std::sqrt(std::max(beside * beside - at_start * at_start, 0.0));
      // Forces that change before the first stage, as friction does at rest, hardly appear in the modes. With stiff forces,
      // the stages of the last step miss the acceleration as well.
      const double turn = 0.5 * table.c[0] * (missed - earlier - last) * control.slack();
      return std::max({last * decay, turn, crossing ? last * control.slack() : 0.0}); // what the stages do not see need not decay
    };
    const double noise = FELT * EPS * (1.0 + largest(p1_)) / std::abs(step) * weight_.tail(system_.nv).maxCoeff() * table.leading;
    double error = left(noise);
    if (error > std::pow(STAGE_SAFETY, control.exponent())) // the next step would be shorter
      error = left(std::max(noise, rounding_of_loops()));
    return error <= 1.0 && system_.sharp ? with_unseen(error) : error;
  }

  // The rounding of the highest mode, in tolerances, that comes from loops closed to rounding. If all velocities are
  // determined, it is that of the positions. Otherwise these only act on the forces, where rows are nearly dependent.
  double rounding_of_loops() {
    const int nv = system_.nv, nc = system_.nc;
    if (nc == 0) return 0.0;
    const RadauTable &table = *newton.stages.table;
    const double reach = 1.0 + largest(p1_);
    rhs_.setZero(nv + nc, 1);
    for (int i = 0; i < nc; ++i) rhs_(nv + i, 0) = i % 2 ? 1.0 : -1.0;
    kkt_.solve(rhs_, 1.0);
    for (int i = 0; i < nc; ++i) rhs_(nv + i, 0) = std::copysign(GAP_LEFT * reach, rhs_(nv + i, 0)); // of the weakest rows
    rhs_.col(0).head(nv).setZero();
    kkt_.solve(rhs_, 1.0);
    shift_ = rhs_.col(0).head(nv);
    if (nc == nv) {
      modes_.col(0) = shift_ / (newton.stages.h * newton.stages.h);
      return size_of(0) * table.leading;
    }
    return largest(shift_) < BESIDE * reach ? 0.0 : rounding_of_forces(TURNED * reach / largest(shift_));
  }

  // The same of the forces there, from positions that differ by shift_ times a scale: rounding is too small to be seen.
  double rounding_of_forces(double scale) {
    const int nv = system_.nv, nc = system_.nc;
    const Stages &of = newton.stages;
    const double t1 = of.time(of.size() - 1);
    shift_ *= scale;
    const FewNumbers row = of.table->modes.row(of.size() - 1).transpose();
    const double speed = (row.transpose() * of.table->inverse).norm() / row.norm() / of.h;
    v_between_ = v1_ + speed * shift_;
    if (!system_.rate_is_velocity) shift_ = system_.moved_by(t1, p1_, v1_, shift_);
    system_.integrate(p1_, shift_, moved_);
    bool regular = index1_.acceleration(t1, moved_, v_between_, a1_, lam1_);
    shift_ = a1_;
    regular = index1_.acceleration(t1, p1_, v1_, a1_, lam1_) && regular;
    system_.constraint(t1, p1_, v1_); // as before
    if (!regular) return 0.0;
    modes_.col(0) = (shift_ - a1_) / scale;
    rhs_.setZero();
    rhs_.col(0).tail(nc) = system_.W.lazyProduct(modes_.col(0));
    kkt_.solve(rhs_, 1.0);
    modes_.col(0) -= rhs_.col(0).head(nv);
    return size_of(0) * row.norm();
  }

  // Whether velocities cross narrow ranges about zero that are not resolved.
  bool crosses() const {
    for (Eigen::Index i = 0; i < system_.widths.size(); ++i) {
      const double width = system_.widths[i], v0 = newton.stages.v[i];
      const double least = std::min(v0, newton.stages.V.row(i).minCoeff()), most = std::max(v0, newton.stages.V.row(i).maxCoeff());
      if (least < width && most > -width && most - least > COARSE * width) return true;
    }
    return false;
  }

  // The larger of an error and of what the stages miss of forces that bend or jump. For smooth forces the difference of
  // the two formulas falls as the error of the step does. Within a step stiff forces undo most of what other forces do to
  // the velocities they hold. What is missed of a bend falls like h²: a power of it falls like the estimate.
  double with_unseen(double seen) {
    const int nv = system_.nv, nc = system_.nc;
    const double h = newton.stages.h;
    const auto size = [&] {
      const double part = rhs_.col(0).head(nv).cwiseProduct(weight_.tail(nv)).norm() / std::sqrt(nv);
      return std::pow(UNSEEN * control.slack() * part, 0.5 * control.exponent()); // it falls like h²
    };
    find_missed_force();
    rhs_.setZero(nv + nc, 1);
    rhs_.col(0).head(nv) = h * missed_;
    kkt_.solve(rhs_, 1.0);
    const double missed = size();
    if (missed <= seen) return seen;
    const auto [M, D, K] = newton.at_end();
    within_.A() = M + h * D + h * h * K;
    rhs_.setZero();
    rhs_.col(0).head(nv) = h * missed_;
    const bool solved = within_.solve_new(system_.W, system_.G_transposed(), 1.0, rhs_);
    return std::max(seen, solved ? std::min(missed, size()) : missed);
  }

  // The mean over a step of forces that may bend or jump, less what the stages see of it.
  void find_missed_force() {
    const Stages &of = newton.stages;
    const RadauTable &table = *of.table;
    missed_.setZero(system_.nv);
    combine(of.W, table.reach, between_v_, of.h);
    combine(of.U(), table.reach, between_, of.h);
    for (Eigen::Index i = 0; i < table.between.size(); ++i) {
      shift_ = between_.col(i);
      system_.integrate(of.p, shift_, moved_);
      v_between_ = of.v + between_v_.col(i);
      system_.sharp_force(of.t + of.h * table.between[i], moved_, v_between_, tau_);
      missed_ += table.weights[i] * tau_;
    }
    for (int i = 0; i < of.size(); ++i) {
      moved_ = of.P.col(i);
      v_between_ = of.V.col(i);
      system_.sharp_force(of.time(i), moved_, v_between_, tau_);
      missed_ -= table.A(of.size() - 1, i) * tau_;
    }
  }

  double size_of(int mode) {
    const int nx = system_.nx, nv = system_.nv;
    const double step = newton.stages.h;
    double sum = modes_.col(mode).cwiseProduct(weight_.tail(nv)).squaredNorm();
    shift_ = modes_.col(mode);
    if (!system_.rate_is_velocity) shift_ = system_.moved_by(newton.stages.t + step, p1_, v1_, shift_);
    sum += (step * shift_.cwiseProduct(weight_.head(nx))).squaredNorm();
    return std::abs(step) * std::sqrt(sum / nv);
  }

  void shorten(double wanted) { h = wanted; }

  int order() const { return 2 * used_s - 1; }
  void keep(Collocations &curve) { curve.push_back(accurate()); }

  int looks() const { return static_cast<int>(LOOKS); }
  bool look(Events &events, double at) {
    if (at == t) return events.look(t, p, v, lam), true;
    if (!sampler.look(last_step(), at, events.with_multipliers())) return false;
    events.look(at, sampler.p, sampler.v, sampler.lam);
    return true;
  }

  void remember() {
    if (remembered_steps_.empty()) remembered_steps_.resize(REMEMBERED);
    Taken &to = remembered_steps_[remembered_++ % REMEMBERED];
    const Stages &of = newton.stages;
    to.table = of.table;
    to.t = of.t;
    to.h = of.h;
    to.p = of.p;
    to.v = of.v;
    to.W = of.W;
  }

  static constexpr double ASTRAY = 1e3;    // tolerances by which the velocity of a step up to an event may differ from the one located
  static constexpr size_t REMEMBERED = 16; // more than the steps of a sample of a controller
  std::vector<Taken> remembered_steps_;    // a ring
  size_t remembered_ = 0;                  // since the last start, or jump of forces

  const Switches switches_;
  std::unique_ptr<RadauStepper> halving_;
  KKT kkt_, within_;
  StiffForces stiff_forces_;
  bool has_stiff_forces_ = false; // the last step
  Vec slope_; // of the acceleration at a start
  Vec stage_a_; // the acceleration here according to the stages of the last step
  bool shaped_ = false;
  Shape shape_;
  Collocations::value_type last_, accurate_;
  std::vector<std::pair<double, Collocations::value_type>> endings_; // of the last step, at events
  Mat modes_, coefficients_, rhs_, all_rhs_, between_, between_v_;
  Vec missed_, tau_, v_between_;
  Vec weight_, p1_, v1_, a1_, lam1_, moved_, shift_;
};

template <class... Numbers> std::tuple<Numbers...> values_of(std::tuple<Numbers &...>);

// A run of Radau IIA between two steps, so that one stepper makes the steps of many runs. A new one has only tolerances.
class RadauMemory {
public:
  RadauMemory() = default;
  explicit RadauMemory(const RadauControl &control) { std::get<RadauControl>(numbers_) = control; }

  void remember(RadauStepper &run) {
    numbers_ = run.lasting();
    table_ = run.newton.stages.table;
    if (table_) run.newton.remember(matrix_);
  }
  void recall(RadauStepper &run) const {
    if (table_ && run.newton.stages.table != table_) run.newton.use(*table_);
    if (run.newton.stages.table) run.newton.recall(matrix_);
    run.lasting() = numbers_;
  }

private:
  decltype(values_of(std::declval<RadauStepper &>().lasting())) numbers_;
  const RadauTable *table_ = nullptr;
  StageMatrix::Memory matrix_;
};

} // namespace pinconsist
