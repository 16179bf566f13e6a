// Plans for a ball that flies through a knot: OMPL's RRT-Connect and PRM, FCL as the exact check of states.
//
//   plan exact knot.obj     every state is asked of FCL
//   plan header knot.obj    states and edges are asked of the header first, and FCL what that leaves open
//   plan calls knot.obj     nanoseconds of single calls
//
// Both modes draw the same random numbers and must print the same paths: a header's *no* is certain.

#include <fcl/fcl.h>
#include <ompl/base/DiscreteMotionValidator.h>
#include <ompl/base/spaces/RealVectorStateSpace.h>
#include <ompl/geometric/PathGeometric.h>
#include <ompl/geometric/SimpleSetup.h>
#include <ompl/geometric/planners/prm/PRM.h>
#include <ompl/geometric/planners/rrt/RRTConnect.h>

#include <chrono>
#include <cstdio>
#include <fstream>
#include <random>
#include <sstream>
#include <string>

#include "knot.h"
#include "knot_network.h"

namespace ob = ompl::base;
namespace og = ompl::geometric;
using Mesh = fcl::BVHModel<fcl::OBBRSSd>;
using Clock = std::chrono::steady_clock;

constexpr double RADIUS = 0.1, REACH = 1.9;
// States are doubles, and queries are float32: what rounding moves one is added to the radius.
constexpr float ASKED = static_cast<float>(RADIUS + 1e-6);
constexpr int PROBLEMS = 60, GROWN = 3000, CALLS = 200000;

double since(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }

std::shared_ptr<Mesh> read(const char *path) {
    std::vector<fcl::Vector3d> vertices;
    std::vector<fcl::Triangle> faces;
    std::ifstream file(path);
    for (std::string line, kind; std::getline(file, line);) {
        std::istringstream words(line);
        words >> kind;
        double x, y, z;
        std::size_t a, b, c;
        if (kind == "v" && words >> x >> y >> z) vertices.emplace_back(x, y, z);
        if (kind == "f" && words >> a >> b >> c) faces.emplace_back(a - 1, b - 1, c - 1);
    }
    auto mesh = std::make_shared<Mesh>();
    mesh->beginModel();
    mesh->addSubModel(vertices, faces);
    mesh->endModel();
    return mesh;
}

struct World {
    std::shared_ptr<Mesh> mesh;
    fcl::Sphered ball{RADIUS};
    bool bounded;
    mutable long exact = 0, states = 0, edges = 0, cleared = 0;

    bool collides(const double *x) const {
        ++exact;
        fcl::Transform3d place = fcl::Transform3d::Identity();
        place.translation() << x[0], x[1], x[2];
        fcl::CollisionRequestd request;
        fcl::CollisionResultd result;
        return fcl::collide(&ball, place, mesh.get(), fcl::Transform3d::Identity(), request, result) > 0;
    }

    bool free(const double *x) const {
        ++states;
        const float q[3] = {static_cast<float>(x[0]), static_cast<float>(x[1]), static_cast<float>(x[2])};
        return (bounded && !knot_within(q, ASKED)) || !collides(x);
    }
};

// Edges that the header clears need no states; others are sampled as OMPL does.
class Validator : public ob::DiscreteMotionValidator {
  public:
    Validator(const ob::SpaceInformationPtr &si, const World &world) : ob::DiscreteMotionValidator(si), world_(world) {}
    using ob::DiscreteMotionValidator::checkMotion;

    bool checkMotion(const ob::State *from, const ob::State *to) const override {
        ++world_.edges;
        float a[3], b[3];
        for (int k = 0; k < 3; ++k) {
            a[k] = static_cast<float>(from->as<ob::RealVectorStateSpace::StateType>()->values[k]);
            b[k] = static_cast<float>(to->as<ob::RealVectorStateSpace::StateType>()->values[k]);
        }
        if (world_.bounded && !knot_segment(a, b, ASKED)) {
            ++world_.cleared;
            return true;
        }
        return ob::DiscreteMotionValidator::checkMotion(from, to);
    }

  private:
    const World &world_;
};

void plan(World &world) {
    auto space = std::make_shared<ob::RealVectorStateSpace>(3);
    space->setBounds(-REACH, REACH);
    og::SimpleSetup setup(space);
    auto si = setup.getSpaceInformation();
    setup.setStateValidityChecker([&](const ob::State *state) {
        return world.free(state->as<ob::RealVectorStateSpace::StateType>()->values);
    });
    si->setMotionValidator(std::make_shared<Validator>(si, world));
    si->setStateValidityCheckingResolution(0.005);
    si->setup();
    std::printf("planner,problem,solved,result,seconds,states,edges,cleared,exact\n");
    const auto begin = [&] { world.exact = world.states = world.edges = world.cleared = 0; };
    const auto row = [&](const char *planner, int problem, int solved, double result, double seconds) {
        std::printf("%s,%d,%d,%.17g,%.6f,%ld,%ld,%ld,%ld\n", planner, problem, solved, result, seconds, world.states,
                    world.edges, world.cleared, world.exact);
    };
    std::mt19937 random(7);
    std::uniform_real_distribution<double> uniform(-REACH, REACH);
    for (int problem = 0; problem < PROBLEMS; ++problem) {
        ob::ScopedState<> ends[2] = {ob::ScopedState<>(space), ob::ScopedState<>(space)};
        for (auto &end : ends) do {
                for (int k = 0; k < 3; ++k) end[k] = uniform(random);
            } while (!world.free(end->as<ob::RealVectorStateSpace::StateType>()->values));
        setup.clear();
        setup.setStartAndGoalStates(ends[0], ends[1]);
        auto planner = std::make_shared<og::RRTConnect>(si);
        planner->setRange(0.4);
        setup.setPlanner(planner);
        setup.setup();
        begin();
        const auto start = Clock::now();
        int left = 100000;
        const ob::PlannerTerminationCondition ends_at([&] { return --left < 0; });
        const bool solved = setup.solve(ends_at) == ob::PlannerStatus::EXACT_SOLUTION;
        row("RRT-Connect", problem, solved, solved ? setup.getSolutionPath().length() : 0.0, since(start));
    }
    og::PRM prm(si);
    prm.setProblemDefinition(setup.getProblemDefinition());
    prm.setup();
    begin();
    const auto start = Clock::now();
    int left = GROWN;
    prm.growRoadmap(ob::PlannerTerminationCondition([&] { return --left < 0; }));
    row("PRM", 0, static_cast<int>(prm.milestoneCount()), static_cast<double>(prm.edgeCount()), since(start));
}

template <typename Call>
void time_of(const char *name, Call call) {
    std::mt19937 random(3);
    std::uniform_real_distribution<float> uniform(-REACH, REACH);
    std::vector<float> q(3 * CALLS);
    for (float &x : q) x = uniform(random);
    double found = 0.0;
    for (int i = 0; i < CALLS / 10; ++i) found += call(&q[3 * i]);
    const auto start = Clock::now();
    for (int i = 0; i < CALLS; ++i) found += call(&q[3 * i]);
    std::printf("%s,%.1f,%.6g\n", name, since(start) * 1e9 / CALLS, found);
}

void calls(World &world) {
    std::printf("call,ns,sum\n");
    time_of("header: distance-grid `within`", [](const float *q) { return double(knot_within(q, ASKED)); });
    time_of("header: distance-grid `segment` of 0.3", [](const float *q) {
        const float b[3] = {q[0] + 0.3f, q[1], q[2]};
        return double(knot_segment(q, b, ASKED));
    });
    time_of("header: mlp 24-24 `within`", [](const float *q) { return double(knot_network_within(q, ASKED)); });
    time_of("FCL: ball against the mesh", [&](const float *q) {
        const double x[3] = {q[0], q[1], q[2]};
        return double(world.collides(x));
    });
}

int main(int count, char **words) {
    const std::string mode = count == 3 ? words[1] : "";
    if (mode != "exact" && mode != "header" && mode != "calls") {
        std::fprintf(stderr, "plan exact|header|calls knot.obj\n");
        return 2;
    }
    ompl::RNG::setSeed(1);
    ompl::msg::setLogLevel(ompl::msg::LOG_ERROR);
    World world{read(words[2]), fcl::Sphered(RADIUS), mode == "header"};
    if (mode == "calls") calls(world);
    else plan(world);
}
