#include "terse/core/initial_values.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <chrono>
#include <cstdio>

#include "shared_data.h"
#include "terse/core/graph_file.h"
#include "terse/core/residual.h"
#include "testing_poses.h"

namespace terse {
namespace {

constexpr InitialValues kComputed[] = {InitialValues::kCompose, InitialValues::kTree, InitialValues::kChordal};

template <class Pose>
struct Problem {
  PoseGraph<Pose> graph;  // relative factors only, no values; ids descend with the index
  std::vector<Pose> T_world_body;
};

PoseId IdOf(int index) { return {100 - 2 * index}; }

// 40 poses along a random walk with loops; `sigma` in metres and radians.
template <class Pose>
Problem<Pose> RandomProblem(unsigned seed, double sigma) {
  constexpr int kPoses = 40;
  testing::PoseRandom random(seed);
  Problem<Pose> out;
  for (int i = 0; i < kPoses; ++i) {
    out.graph.AddPose(IdOf(i));
    out.T_world_body.push_back(i == 0 ? testing::RandomPose<Pose>(random, 3)
                                      : out.T_world_body.back() * testing::RandomPose<Pose>(random, 1));
  }
  const auto add = [&](int i, int j) {
    const Pose T_i_j = out.T_world_body[std::size_t(i)].Inverse() * out.T_world_body[std::size_t(j)];
    const auto information = random.Information<Pose::kDof>();
    // Noise as the information says: L'^-1 n has covariance (L L')^-1.
    const typename Pose::Tangent noise = sigma * Eigen::Matrix<double, Pose::kDof, Pose::kDof>(information)
                                                     .llt()
                                                     .matrixU()
                                                     .solve(random.NormalVector<Pose::kDof>());
    out.graph.AddFactor(RelativePoseFactor<Pose>{
        IdOf(i), IdOf(j), T_i_j.Retract(noise),
        sigma > 0 ? typename Pose::Jacobian(information / (sigma * sigma)) : typename Pose::Jacobian(information)});
  };
  for (int i = 1; i < kPoses; ++i) random.Uniform(0, 1) < 0.5 ? add(i - 1, i) : add(i, i - 1);
  for (int k = 0; k < 2 * kPoses; ++k) {
    const int i = static_cast<int>(random.Uniform(0, kPoses)), j = static_cast<int>(random.Uniform(0, kPoses));
    if (i != j) add(i, j);
  }
  return out;
}

template <class Pose>
double Distance(const std::vector<Pose>& a, const std::vector<Pose>& b) {
  double worst = 0;
  for (std::size_t i = 0; i < a.size(); ++i) worst = std::max(worst, a[i].Local(b[i]).cwiseAbs().maxCoeff());
  return worst;
}

template <class Pose>
class InitialValuesTest : public ::testing::Test {};
using PoseTypes = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(InitialValuesTest, PoseTypes);

// Rounding over 40 compositions of metres and a linear system of condition number below 1e6.
constexpr double kRounding = 1e-9;

TYPED_TEST(InitialValuesTest, NoiseFreeGraphsAreRecoveredWhateverGivesTheFrame) {
  using Pose = TypeParam;
  const auto information = Pose::Jacobian::Identity().eval();
  for (unsigned seed = 0; seed < 20; ++seed) {
    SCOPED_TRACE(seed);
    const Problem<Pose> problem = RandomProblem<Pose>(seed, 0);
    const auto& truth = problem.T_world_body;
    const auto check = [&](const PoseGraph<Pose>& graph, const char* what) {
      for (const auto method : kComputed) {
        EXPECT_LT(Distance(ComputeInitialValues(graph, method), truth), kRounding)
            << what << ", method " << static_cast<int>(method);
      }
    };
    const PoseId first = IdOf(39);  // the lowest id
    PoseGraph<Pose> graph = problem.graph;
    graph.SetPose(first, truth[39]);
    check(graph, "value");

    graph = problem.graph;
    graph.AddFactor(PosePriorFactor<Pose>{first, truth[39], 1e-3 * information});
    check(graph, "prior");
    graph.AddFactor(PosePriorFactor<Pose>{IdOf(4), truth[4], information});
    check(graph, "two priors");

    graph = problem.graph;
    for (const int i : {3, 12, 30}) {
      graph.AddFactor(PositionPriorFactor<Pose>{IdOf(i), truth[std::size_t(i)].Translation(),
                                                Matrix<Pose::kDim, Pose::kDim>::Identity()});
    }
    check(graph, "position priors");

    graph = problem.graph;
    graph.SetPose(first, Pose());
    graph.SetPose(IdOf(7), truth[7]);
    graph.SetPose(IdOf(5), truth[0]);
    graph.SetFixed(IdOf(7), true);
    check(graph, "fixed");
    const Pose fixed = ComputeInitialValues(graph, InitialValues::kChordal)[7];
    EXPECT_EQ(fixed.Translation(), truth[7].Translation());

    graph = problem.graph;
    std::vector<Pose> in_frame_of_first = truth;
    for (Pose& T : in_frame_of_first) T = truth[39].Inverse() * T;
    for (const auto method : kComputed) {
      EXPECT_LT(Distance(ComputeInitialValues(graph, method), in_frame_of_first), kRounding) << "identity";
    }
  }
}

TYPED_TEST(InitialValuesTest, ChordalIsBelowComposeAndStationaryInTranslation) {
  using Pose = TypeParam;
  for (unsigned seed = 0; seed < 20; ++seed) {
    SCOPED_TRACE(seed);
    const Problem<Pose> problem = RandomProblem<Pose>(seed, 0.1);
    PoseGraph<Pose> graph = problem.graph;
    const std::vector<Pose> chordal = ComputeInitialValues(graph, InitialValues::kChordal);
    const double chi2 = Chi2(graph.WithPoses(chordal));
    EXPECT_LT(chi2, Chi2(graph.WithPoses(ComputeInitialValues(graph, InitialValues::kCompose))));
    EXPECT_LT(chi2, Chi2(graph.WithPoses(ComputeInitialValues(graph, InitialValues::kTree))));
    // Moving any one translation raises chi2, as the translations minimise it given the rotations.
    testing::PoseRandom random(seed);
    for (int trial = 0; trial < 10; ++trial) {
      std::vector<Pose> moved = chordal;
      typename Pose::Tangent d = Pose::Tangent::Zero();
      d.template head<Pose::kDim>() = 1e-3 * random.NormalVector<Pose::kDim>();
      Pose& T = moved[static_cast<std::size_t>(random.Uniform(0, 40))];
      T = T.Retract(d);
      EXPECT_GT(Chi2(graph.WithPoses(moved)), chi2);
    }
  }
}

TYPED_TEST(InitialValuesTest, FileValuesAndErrors) {
  using Pose = TypeParam;
  const Problem<Pose> problem = RandomProblem<Pose>(1, 0);
  PoseGraph<Pose> graph = problem.graph;
  for (int i = 0; i < 40; ++i) {
    if (i != 11) graph.SetPose(IdOf(i), problem.T_world_body[std::size_t(i)]);
  }
  try {
    ComputeInitialValues(graph, InitialValues::kFile);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_STREQ(error.what(), "pose 78 has no value");
  }
  graph.SetPose(IdOf(11), problem.T_world_body[11]);
  EXPECT_LT(Distance(ComputeInitialValues(graph, InitialValues::kFile), problem.T_world_body), kRounding);
  graph.AddPose({1000});
  for (const auto method : kComputed) EXPECT_THROW(ComputeInitialValues(graph, method), std::invalid_argument);
  EXPECT_TRUE(ComputeInitialValues(PoseGraph<Pose>(), InitialValues::kChordal).empty());
}

struct PublicCase {
  const char* path;
  RotationInformation meaning;
  double optimum;  // chi2, 0: not known
};

TEST(InitialValuesData, ChordalStartsOfPublicGraphs) {
  const PublicCase cases[] = {{"graphs/3d/torus3D.g2o", RotationInformation::kRadians, 24235},
                              {"graphs/2d/city10000.g2o", RotationInformation::kQuaternion, 511.985},
                              {"graphs/3d/sphere2500.g2o", RotationInformation::kRadians, 1351.40},
                              {"graphs/3d/parking-garage.g2o", RotationInformation::kRadians, 1.26838},
                              {"graphs/3d/sphere_bignoise_vertex3.g2o", RotationInformation::kRadians, 0}};
  for (const PublicCase& c : cases) {
    TERSE_NEEDS(path, c.path);
    ReadOptions options;
    options.rotation_information = c.meaning;
    const GraphFile file = ReadGraph(path, options);
    std::visit(
        [&](const auto& graph) {
          double chi2[4] = {};
          for (const auto method : kComputed) {
            const auto start = std::chrono::steady_clock::now();
            const auto values = ComputeInitialValues(graph, method);
            const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
            const int m = static_cast<int>(method);
            chi2[m] = Chi2(graph.WithPoses(values));
            std::printf("%-40s method %d chi2 %12.6g in %.3f s\n", c.path, m, chi2[m], seconds.count());
          }
          const double chordal = chi2[static_cast<int>(InitialValues::kChordal)];
          EXPECT_LT(chordal, chi2[static_cast<int>(InitialValues::kCompose)]) << c.path;
          // No start is below the optimum: chi2 and the reading of the file agree with the published numbers.
          EXPECT_GT(chordal, 0.9999 * c.optimum) << c.path;
        },
        file.graph);
  }
}

}  // namespace
}  // namespace terse
