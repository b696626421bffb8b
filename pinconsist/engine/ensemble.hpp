// Many runs of one mechanism on several threads, each of which makes the steps of any run with its own system and stepper.
#pragma once

#include "numbers.hpp"
#include "radau_stepper.hpp"
#include "threads.hpp"

#include <string>

namespace pinconsist {

class Ensemble {
public:
  // Times, positions and velocities that were reached, and the multipliers of the last step.
  Vec t;
  Table p, v, lam;
  // What each run holds: torques of all velocities, then commands; NaN where nothing was given.
  Table held;
  Table numbers; // of each run, see numbers.hpp

  Ensemble(int runs, const System &system, int commands)
      : t(Vec::Zero(runs)), p(Table::Zero(runs, system.npos)), v(Table::Zero(runs, system.nv)), lam(Table::Zero(runs, system.nc)),
        held(Table::Constant(runs, system.nv + commands, NOT_A_NUMBER)), numbers(runs, 0), memories_(runs), begun_(runs, false) {}

  Ensemble(const Ensemble &) = delete;

  // All of the same equations; `tables` are those of the torques of all velocities, and of commands. It has no run yet.
  void add_worker(RadauStepper &run, MechanismSystem &system, Numbers &own, const std::vector<HeldTable *> &tables) {
    workers_.push_back(std::make_unique<Worker>(run, system, own, tables));
  }

  // Runs begin anew at a state, and hold nothing.
  void begin(const std::vector<int> &runs, double time, const Table &positions, const Table &velocities) {
    for (size_t k = 0; k < runs.size(); ++k) {
      const int i = runs[k];
      t[i] = time;
      p.row(i) = positions.row(k);
      v.row(i) = velocities.row(k);
      held.row(i).setConstant(NOT_A_NUMBER);
      begun_[i] = false;
    }
  }

  // Runs get other numbers and begin anew where they are; positions are closed first, if these `open` the loops. Why that
  // fails, for each run: such a run is not changed.
  std::vector<std::string> change(const std::vector<int> &runs, const Table &values, bool open) {
    std::vector<std::string> failures(runs.size());
    each(runs, [&](Worker &worker, int i, size_t k) {
      if (open) {
        worker.numbers.set(values.row(k).transpose());
        const State on = worker.index1.project(t[i], p.row(i).transpose(), v.row(i).transpose());
        failures[k] = on.failure;
        if (*on.failure) return;
        p.row(i) = on.p.transpose();
        v.row(i) = on.v.transpose();
      }
      numbers.row(i) = values.row(k);
      begun_[i] = false;
    });
    return failures;
  }

  // How far states are from the constraints, with the numbers of these runs.
  Vec off(const std::vector<int> &runs, double time, const Table &positions, const Table &velocities) {
    Vec distances(runs.size());
    each(runs, [&](Worker &worker, int i, size_t k) {
      worker.numbers.set(numbers.row(i).transpose());
      worker.system.constraint(time, positions.row(k).transpose(), velocities.row(k).transpose());
      distances[k] = std::max(largest(worker.system.phi), largest(worker.system.rho));
    });
    return distances;
  }

  // Advance runs under torques and commands, a row for each of all runs; why each failed, or nothing.
  std::vector<std::string> advance(const std::vector<int> &runs, const Table &wanted, double dt) {
    std::vector<std::string> failures(runs.size());
    each(runs, [&](Worker &worker, int i, size_t k) { failures[k] = step(worker, i, wanted, dt); });
    return failures;
  }

  // The multipliers at the states, with what was held until there; NaN where the equations are singular.
  Table multipliers() {
    std::vector<int> fresh;
    for (int i = 0; i < static_cast<int>(begun_.size()); ++i)
      if (!begun_[i]) fresh.push_back(i);
    Table all = lam;
    each(fresh, [&](Worker &worker, int i, size_t) {
      worker.numbers.set(numbers.row(i).transpose());
      hold(worker, i);
      Vec a, found;
      if (worker.index1.acceleration(t[i], p.row(i).transpose(), v.row(i).transpose(), a, found)) all.row(i) = found.transpose();
      else all.row(i).setConstant(NOT_A_NUMBER);
    });
    return all;
  }

private:
  static constexpr long BATCH = 1000;

  struct Worker {
    RadauStepper &run;
    MechanismSystem &system;
    Numbers &numbers;
    std::vector<HeldTable *> tables;
    Projection index1;
    RadauMemory blank; // of a run that has not begun

    Worker(RadauStepper &its_run, MechanismSystem &its_system, Numbers &its_numbers, std::vector<HeldTable *> its_tables)
        : run(its_run), system(its_system), numbers(its_numbers), tables(std::move(its_tables)), index1(its_system),
          blank(its_run.control) {}
  };

  // Calls work(worker, run, its index among these) for some runs, each on one of the threads.
  template <class Work> void each(const std::vector<int> &runs, const Work &work) {
    nb::gil_scoped_release release;
    threads_.each(runs.size(), workers_.size(), [&](size_t thread, size_t k) { work(*workers_[thread], runs[k], k); });
  }

  // The first column and the number of columns of each table among what is held.
  template <class Take> void for_tables(const Worker &worker, const Take &take) const {
    const int commands = static_cast<int>(worker.tables.size()) - 1, torques = static_cast<int>(held.cols()) - commands;
    for (int k = 0; k <= commands; ++k) take(*worker.tables[k], k ? torques + k - 1 : 0, k ? 1 : torques);
  }

  // Let the tables of a worker have what a run holds.
  void hold(Worker &worker, int i) const {
    for_tables(worker, [&](HeldTable &table, int first, int size) {
      const auto now = held.row(i).segment(first, size);
      table.clear(1.0);
      if (now.allFinite()) table.hold(t[i], now.transpose());
    });
  }

  // Take over what a run holds from now on; whether it differs from before.
  bool take(const Worker &worker, int i, const Table &wanted) {
    bool changed = false;
    for_tables(worker, [&](HeldTable &, int first, int size) {
      const auto now = wanted.row(i).segment(first, size);
      auto before = held.row(i).segment(first, size);
      const bool nothing = first == 0 && !before.allFinite() && now.isZero(0.0); // no torque was given yet
      if (!now.allFinite() || nothing || before == now) return;
      before = now;
      changed = true;
    });
    return changed;
  }

  std::string step(Worker &worker, int i, const Table &wanted, double dt) {
    RadauStepper &run = worker.run;
    try {
      worker.numbers.set(numbers.row(i).transpose());
      bool jumped = take(worker, i, wanted);
      hold(worker, i);
      (begun_[i] ? memories_[i] : worker.blank).recall(run);
      if (!begun_[i]) {
        jumped = false;
        const char *failure = start(worker, i);
        if (*failure) return failure;
      }
      const double t_end = t[i] + dt;
      std::string failure;
      while (run.t != t_end && failure.empty()) {
        const Reason reason = run.run(t_end, BATCH, {false, nullptr, none_, none_}, std::exchange(jumped, false));
        run.output = {};
        const bool goes_on = reason == Reason::steps || (reason == Reason::slow && run.to_come <= ENDLESS);
        if (run.failure != Failure::none) failure = name_of(run.failure);
        else if (run.t != t_end && !goes_on) failure = "chatters";
      }
      t[i] = run.t;
      p.row(i) = run.p.transpose();
      v.row(i) = run.v.transpose();
      lam.row(i) = run.lam.transpose();
      if (failure.empty()) memories_[i].remember(run);
      return failure;
    } catch (const std::exception &error) {
      return error.what();
    }
  }

  // Start a run from its state, on the constraints; why that fails.
  const char *start(Worker &worker, int i) {
    const State on = worker.index1.project(t[i], p.row(i).transpose(), v.row(i).transpose());
    if (*on.failure) return on.failure;
    Vec a, multipliers;
    if (!worker.index1.acceleration(t[i], on.p, on.v, a, multipliers)) return "singular";
    if (!a.allFinite() || !multipliers.allFinite()) return "not_finite";
    worker.run.begin_at(t[i], on.p, on.v, a, multipliers);
    begun_[i] = true;
    return "";
  }

  const nb::object none_ = nb::none(); // in place of functions
  std::vector<std::unique_ptr<Worker>> workers_;
  Threads threads_;
  std::vector<RadauMemory> memories_;
  std::vector<char> begun_;
};

} // namespace pinconsist
