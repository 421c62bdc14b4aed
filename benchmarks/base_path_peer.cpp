// The peer of bench_base_path.py: RRT-Connect of OMPL, all in C++, over the same lattice.
//
// Reads from a file: nx, ny, headings (int32), x, y of the corner and edge of a cell, reach and
// time limit (double), the lattice (uint8, 1 = clear), number of queries (int32), and per query
// start and goal (6 doubles). Writes a line per query and repetition: processor time [s], 1 if
// solved, length [m].
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <memory>
#include <vector>

#include <ompl/base/MotionValidator.h>
#include <ompl/base/PlannerTerminationCondition.h>
#include <ompl/base/ProblemDefinition.h>
#include <ompl/base/SpaceInformation.h>
#include <ompl/base/spaces/SE2StateSpace.h>
#include <ompl/geometric/PathGeometric.h>
#include <ompl/geometric/planners/rrt/RRTConnect.h>
#include <ompl/util/Console.h>

namespace ob = ompl::base;
namespace og = ompl::geometric;

struct Lattice {
  std::int32_t nx, ny, headings;
  double x, y, edge, reach, limit;
  std::vector<std::uint8_t> cells;

  bool clear(double px, double py, double yaw) const {
    const double u = (px - x) / edge, v = (py - y) / edge;
    if (!(u >= 0.0 && u < nx && v >= 0.0 && v < ny)) return false;
    long k = static_cast<long>(std::floor(yaw * headings / (2.0 * M_PI) + 0.5)) % headings;
    if (k < 0) k += headings;
    return cells[(static_cast<std::size_t>(u) * ny + static_cast<std::size_t>(v)) * headings + k] == 1;
  }
};

double wrapped(double angle) {
  return angle - 2.0 * M_PI * std::floor((angle + M_PI) / (2.0 * M_PI));
}

// Turn, drive straight, turn; forwards or backwards, whichever turns less.
class DriveValidator : public ob::MotionValidator {
 public:
  DriveValidator(const ob::SpaceInformationPtr& information, const Lattice& lattice)
      : ob::MotionValidator(information), lattice_(lattice) {}

  bool checkMotion(const ob::State* first, const ob::State* second) const override {
    const auto* a = first->as<ob::SE2StateSpace::StateType>();
    const auto* b = second->as<ob::SE2StateSpace::StateType>();
    const double dx = b->getX() - a->getX(), dy = b->getY() - a->getY();
    const double length = std::hypot(dx, dy);
    double before = wrapped(b->getYaw() - a->getYaw()), after = 0.0;
    if (length >= 1e-6) {
      const double heading = std::atan2(dy, dx);
      before = wrapped(heading - a->getYaw());
      after = wrapped(b->getYaw() - heading);
      if (std::abs(before) + std::abs(after) > M_PI + 1e-9) {
        before = wrapped(before + M_PI);
        after = wrapped(after + M_PI);
      }
    }
    const double angle = 2.0 * M_PI / lattice_.headings, yaw = a->getYaw() + before;
    const int turn = steps(std::abs(before) / angle), drive = steps(length / lattice_.edge);
    const int last = steps(std::abs(after) / angle);
    for (int n = 0; n <= turn; ++n) {
      const double share = turn ? static_cast<double>(n) / turn : 0.0;
      if (!lattice_.clear(a->getX(), a->getY(), a->getYaw() + share * before)) return false;
    }
    for (int n = 1; n <= drive; ++n) {
      const double share = static_cast<double>(n) / drive;
      if (!lattice_.clear(a->getX() + share * dx, a->getY() + share * dy, yaw)) return false;
    }
    for (int n = 1; n <= last; ++n) {
      const double share = static_cast<double>(n) / last;
      if (!lattice_.clear(b->getX(), b->getY(), yaw + share * after)) return false;
    }
    return true;
  }

  bool checkMotion(const ob::State* a, const ob::State* b,
                   std::pair<ob::State*, double>&) const override {
    return checkMotion(a, b);
  }

 private:
  static int steps(double count) { return static_cast<int>(std::ceil(count - 1e-9)); }
  const Lattice& lattice_;
};

void answer(const Lattice& lattice, const double* query) {
  const std::clock_t begin = std::clock();
  auto space = std::make_shared<ob::SE2StateSpace>();
  ob::RealVectorBounds bounds(2);
  bounds.setLow(0, lattice.x);
  bounds.setHigh(0, lattice.x + lattice.nx * lattice.edge);
  bounds.setLow(1, lattice.y);
  bounds.setHigh(1, lattice.y + lattice.ny * lattice.edge);
  space->setBounds(bounds);
  auto information = std::make_shared<ob::SpaceInformation>(space);
  information->setStateValidityChecker([](const ob::State*) { return true; });
  information->setMotionValidator(std::make_shared<DriveValidator>(information, lattice));
  information->setup();
  ob::ScopedState<ob::SE2StateSpace> start(space), goal(space);
  start->setXY(query[0], query[1]);
  start->setYaw(wrapped(query[2]));
  goal->setXY(query[3], query[4]);
  goal->setYaw(wrapped(query[5]));
  auto problem = std::make_shared<ob::ProblemDefinition>(information);
  problem->setStartAndGoalStates(start, goal);
  og::RRTConnect planner(information);
  planner.setRange(lattice.reach);
  planner.setProblemDefinition(problem);
  planner.setup();
  planner.solve(ob::timedPlannerTerminationCondition(lattice.limit));
  const double taken = static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
  double length = 0.0;
  if (problem->hasExactSolution()) {
    const auto path = std::static_pointer_cast<og::PathGeometric>(problem->getSolutionPath());
    for (std::size_t n = 1; n < path->getStateCount(); ++n) {
      const auto* a = path->getState(n - 1)->as<ob::SE2StateSpace::StateType>();
      const auto* b = path->getState(n)->as<ob::SE2StateSpace::StateType>();
      length += std::hypot(b->getX() - a->getX(), b->getY() - a->getY());
    }
  }
  std::printf("%.9f %d %.6f\n", taken, problem->hasExactSolution() ? 1 : 0, length);
}

template <typename T>
T read(std::ifstream& file) {
  T value;
  file.read(reinterpret_cast<char*>(&value), sizeof value);
  return value;
}

int main(int, char** arguments) {
  ompl::msg::setLogLevel(ompl::msg::LOG_ERROR);
  std::ifstream file(arguments[1], std::ios::binary);
  Lattice lattice;
  lattice.nx = read<std::int32_t>(file);
  lattice.ny = read<std::int32_t>(file);
  lattice.headings = read<std::int32_t>(file);
  for (double* value : {&lattice.x, &lattice.y, &lattice.edge, &lattice.reach, &lattice.limit})
    *value = read<double>(file);
  lattice.cells.resize(static_cast<std::size_t>(lattice.nx) * lattice.ny * lattice.headings);
  file.read(reinterpret_cast<char*>(lattice.cells.data()), lattice.cells.size());
  std::vector<double> queries(6 * static_cast<std::size_t>(read<std::int32_t>(file)));
  file.read(reinterpret_cast<char*>(queries.data()), queries.size() * sizeof(double));
  const int repetitions = std::atoi(arguments[2]);
  for (int repetition = 0; repetition < repetitions; ++repetition)
    for (std::size_t n = 0; n < queries.size(); n += 6) answer(lattice, &queries[n]);
  return 0;
}
