// `terse covariance` and `terse solve --covariances all-steps` against dense inverses.

#include <gtest/gtest.h>

#include <algorithm>

#include "terse/core/graph_file.h"
#include "terse/core/pose_values.h"
#include "testing.h"
#include "testing_command.h"

namespace terse {
namespace {

using Eigen::MatrixXd;
using testing::CsvRows;
using testing::Outcome;
using testing::Random;
using testing::RelativeError;

MatrixXd ToMatrix(const nlohmann::json& rows) {
  MatrixXd out(rows.size(), rows.at(0).size());
  for (Eigen::Index r = 0; r < out.rows(); ++r) {
    for (Eigen::Index c = 0; c < out.cols(); ++c) out(r, c) = rows.at(std::size_t(r)).at(std::size_t(c)).get<double>();
  }
  return out;
}

// The last n * n cells of a row.
MatrixXd LastCells(const std::vector<std::string>& row, Eigen::Index n) {
  MatrixXd out(n, n);
  const std::size_t start = row.size() - std::size_t(n * n);
  for (Eigen::Index i = 0; i < n * n; ++i) out(i / n, i % n) = std::stod(row.at(start + std::size_t(i)));
  return out;
}

// From body frame, translation first: by the definitions, e = Ad(T) d, and entries reordered.
template <class Pose>
MatrixXd Convention(const Pose& T, const std::string& frame, const std::string& order) {
  MatrixXd M = MatrixXd::Identity(Pose::kDof, Pose::kDof);
  if (frame == "world") M = T.Adjoint();
  if (frame == "world-axes") {
    // R: where T takes the axes, seen from where it takes the origin.
    for (int k = 0; k < Pose::kDim; ++k) {
      const typename Pose::Position axis = T * typename Pose::Position(Pose::Position::Unit(k));
      M.block(0, k, Pose::kDim, 1) = axis - T.Translation();
    }
    if (Pose::kDim == 3) M.bottomRightCorner(3, 3) = M.topLeftCorner(3, 3).eval();
  }
  if (order == "translation-first") return M;
  MatrixXd swapped(Pose::kDof, Pose::kDof);
  swapped << M.bottomRows(Pose::kDof - Pose::kDim), M.topRows(Pose::kDim);
  return swapped;
}

struct Choice {
  std::string frame, order;
  std::string Options() const { return " --frame " + frame + " --order " + order; }
};
const std::vector<Choice> kChoices = {{"body", "translation-first"},       {"world", "translation-first"},
                                      {"world-axes", "translation-first"}, {"body", "rotation-first"},
                                      {"world-axes", "rotation-first"},    {"world", "rotation-first"}};

template <class Pose>
class CovarianceCommand : public testing::CommandTest {
 protected:
  static constexpr int B = Pose::kDof;

  // Written to in.g2o and read again, with the dense inverse at its values. Ids are 100, 107, 114, ...
  void MakeGraph(std::uint64_t seed, double noise = 0.02, bool priors = false) {
    Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = 12;
    options.noise = noise;
    options.priors = priors;
    options.id_stride = 7;
    WriteG2o(testing::MakeRandomGraph<Pose>(rng, options).graph, Path("in.g2o"));
    graph_ = ReadAs("in.g2o");
    Sigma_ = testing::Inverse(testing::MakeDenseSystem(graph_, internal::ValuesOf(graph_)).H);
  }
  PoseGraph<Pose> ReadAs(const std::string& name, const ReadOptions& options = {}) const {
    return std::get<PoseGraph<Pose>>(ReadGraph(Path(name), options).graph);
  }
  Pose ValueOf(std::int64_t id) const { return *graph_.Poses()[std::size_t(graph_.IndexOf({id}))].T_world_body; }
  MatrixXd DenseBlock(std::int64_t a, std::int64_t b) const {
    return Sigma_.block<B, B>(B * graph_.IndexOf({a}), B * graph_.IndexOf({b}));
  }
  MatrixXd Expected(const std::vector<std::int64_t>& ids, const Choice& choice) const {
    MatrixXd out(B * Eigen::Index(ids.size()), B * Eigen::Index(ids.size()));
    for (std::size_t r = 0; r < ids.size(); ++r) {
      for (std::size_t c = 0; c < ids.size(); ++c) {
        out.block<B, B>(B * Eigen::Index(r), B * Eigen::Index(c)) =
            Convention(ValueOf(ids[r]), choice.frame, choice.order) * DenseBlock(ids[r], ids[c]) *
            Convention(ValueOf(ids[c]), choice.frame, choice.order).transpose();
      }
    }
    return out;
  }

  PoseGraph<Pose> graph_;
  MatrixXd Sigma_;
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CovarianceCommand, Groups);

// The dense inverse beside the anchor's 1e8 is good to about 1e-10.
constexpr double kTolerance = 1e-8;

TYPED_TEST(CovarianceCommand, MarginalsEqualTheDenseInverse) {
  this->MakeGraph(1);
  for (const Choice& choice : kChoices) {
    const auto all = this->Json("covariance in.g2o --quiet --json" + choice.Options());
    ASSERT_EQ(all.size(), this->graph_.Poses().size());
    for (std::size_t k = 0; k < all.size(); ++k) {
      const std::int64_t id = this->graph_.Poses()[k].id.value;
      EXPECT_EQ(all[k]["ids"], std::vector<std::int64_t>{id});
      EXPECT_EQ(all[k]["frame"], choice.frame);
      EXPECT_EQ(all[k]["order"], choice.order);
      EXPECT_LT(RelativeError(ToMatrix(all[k]["covariance"]), this->Expected({id}, choice)), kTolerance) << id;
    }
    // In the order asked for; ids may repeat.
    const auto some = this->Json("covariance in.g2o --quiet --json --ids 142,107,142" + choice.Options());
    ASSERT_EQ(some.size(), 3u);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::int64_t id = k == 1 ? 107 : 142;
      EXPECT_EQ(some[k]["ids"], std::vector<std::int64_t>{id});
      EXPECT_LT(RelativeError(ToMatrix(some[k]["covariance"]), this->Expected({id}, choice)), kTolerance) << id;
    }
    const auto one = this->Json("covariance in.g2o --quiet --json --ids 142" + choice.Options());
    EXPECT_TRUE(one.is_object()) << "of a single pose: no list";
    EXPECT_EQ(one["ids"], some[0]["ids"]);
    // What else is asked for may change the order of sums.
    EXPECT_LT(RelativeError(ToMatrix(one["covariance"]), ToMatrix(some[0]["covariance"])), 1e-12);
  }
}

TYPED_TEST(CovarianceCommand, TheJointEqualsTheDenseInverse) {
  this->MakeGraph(2, 0.02, true);
  for (const Choice& choice : kChoices) {
    const auto json = this->Json("covariance in.g2o --quiet --json --joint --ids 177,107,128" + choice.Options());
    EXPECT_EQ(json["ids"], (std::vector<std::int64_t>{177, 107, 128}));
    EXPECT_EQ(json["frame"], choice.frame);
    EXPECT_EQ(json["order"], choice.order);
    EXPECT_EQ(json.size(), 4u);
    const MatrixXd joint = ToMatrix(json["covariance"]);
    EXPECT_LT(RelativeError(joint, this->Expected({177, 107, 128}, choice)), kTolerance);
    EXPECT_EQ(joint, joint.transpose());
  }
}

TYPED_TEST(CovarianceCommand, TheRelativeOneFollowsFromTheJoint) {
  constexpr int B = TypeParam::kDof;
  this->MakeGraph(3);
  const Choice native = kChoices[0];
  for (const auto& [a, b] : {std::pair<std::int64_t, std::int64_t>{107, 170}, {170, 121}, {100, 107}}) {
    const TypeParam T_a_b = this->ValueOf(a).Inverse() * this->ValueOf(b);
    // T_a_b Exp(d) = (T_a Exp(d_a))^-1 T_b Exp(d_b).
    MatrixXd J(B, 2 * B);
    J << -T_a_b.Inverse().Adjoint(), MatrixXd::Identity(B, B);
    const MatrixXd body = J * this->Expected({a, b}, native) * J.transpose();
    for (const Choice& choice : kChoices) {
      const auto json = this->Json("covariance in.g2o --quiet --json --relative " + std::to_string(a) + ' ' +
                                   std::to_string(b) + choice.Options());
      EXPECT_EQ(json["from"], a);
      EXPECT_EQ(json["to"], b);
      EXPECT_EQ(json["frame"], choice.frame);
      EXPECT_EQ(json["order"], choice.order);
      EXPECT_EQ(json.size(), 5u);
      const MatrixXd M = Convention(T_a_b, choice.frame, choice.order);
      EXPECT_LT(RelativeError(ToMatrix(json["covariance"]), M * body * M.transpose()), 1e-7) << a << ' ' << b;
    }
  }
}

TYPED_TEST(CovarianceCommand, TablesHoldTheSameNumbers) {
  constexpr int B = TypeParam::kDof;
  this->MakeGraph(4);
  const std::string run = "covariance in.g2o --quiet";
  const std::string all = this->Succeed(run + " --order rotation-first").out;
  EXPECT_EQ(all.rfind(B == 3 ? "id,theta_theta,theta_x,theta_y," : "id,rx_rx,rx_ry,rx_rz,rx_x,", 0), 0u) << all;
  auto json = this->Json(run + " --order rotation-first --json");
  auto rows = CsvRows(all);
  ASSERT_EQ(rows.size(), json.size());
  for (std::size_t k = 0; k < rows.size(); ++k) {
    ASSERT_EQ(rows[k].size(), std::size_t(1 + B * B));
    EXPECT_EQ(rows[k][0], json[k]["ids"][0].dump());
    EXPECT_EQ(LastCells(rows[k], B), ToMatrix(json[k]["covariance"]));
  }
  const std::string relative = this->Succeed(run + " --relative 100 121").out;
  EXPECT_EQ(relative.rfind("from,to,x_x,x_y,", 0), 0u) << relative;
  rows = CsvRows(relative);
  ASSERT_EQ(rows.size(), 1u);
  EXPECT_EQ(rows[0][0] + ' ' + rows[0][1], "100 121");
  EXPECT_EQ(LastCells(rows[0], B), ToMatrix(this->Json(run + " --relative 100 121 --json")["covariance"]));

  const std::string joint = this->Succeed(run + " --ids 107,121 --joint").out;
  EXPECT_EQ(joint.rfind("id,component,107_x,107_y,", 0), 0u) << joint;
  rows = CsvRows(joint);
  const MatrixXd expected = ToMatrix(this->Json(run + " --ids 107,121 --joint --json")["covariance"]);
  ASSERT_EQ(rows.size(), std::size_t(2 * B));
  for (std::size_t r = 0; r < rows.size(); ++r) {
    ASSERT_EQ(rows[r].size(), std::size_t(2 + 2 * B));
    EXPECT_EQ(rows[r][0], r < std::size_t(B) ? "107" : "121");
    EXPECT_EQ(rows[r][1], rows[r + std::size_t(B) < rows.size() ? r + std::size_t(B) : r - std::size_t(B)][1]);
    for (std::size_t c = 0; c < std::size_t(2 * B); ++c) {
      EXPECT_EQ(std::stod(rows[r][2 + c]), expected(Eigen::Index(r), Eigen::Index(c)));
    }
  }
}

TYPED_TEST(CovarianceCommand, SolveTakesTheOptimum) {
  this->MakeGraph(5, 0.2);
  const Outcome away = this->Succeed("covariance in.g2o --json");
  EXPECT_NE(away.err.find("the values are not at the minimum"), std::string::npos) << away.err;
  EXPECT_EQ(this->Succeed("covariance in.g2o --json --quiet").err, "");
  const Outcome solved = this->Succeed("covariance in.g2o --json --solve");
  EXPECT_EQ(solved.err, "");
  EXPECT_NE(solved.out, away.out);
  this->Succeed("solve in.g2o --output out.g2o");
  const Outcome there = this->Succeed("covariance out.g2o --json");
  EXPECT_EQ(there.err, "") << "no warning at the optimum";
  const auto expected = nlohmann::json::parse(there.out), actual = nlohmann::json::parse(solved.out);
  for (std::size_t k = 0; k < expected.size(); ++k) {
    // Values of the optimum up to 1e-11 of chi2.
    EXPECT_LT(RelativeError(ToMatrix(actual[k]["covariance"]), ToMatrix(expected[k]["covariance"])), 1e-4);
  }
}

TYPED_TEST(CovarianceCommand, OutputGoesToTheFile) {
  this->MakeGraph(6);
  for (const std::string options :
       {"", " --json", " --json --ids 100", " --joint --ids 100,121", " --relative 100 121"}) {
    const std::string run = "covariance in.g2o --quiet" + options;
    const Outcome outcome = this->Succeed(run + " --output out");
    EXPECT_EQ(outcome.out + outcome.err, "");
    EXPECT_EQ(this->Read("out"), this->Succeed(run).out) << options;
    EXPECT_EQ(this->Read("out").back(), '\n');
  }
  this->ExpectFailure("covariance in.g2o --output nowhere/out", 1, "folder nowhere does not exist");
}

// With exact measurements composed values are the optimum, so linearisation points of every step are too.
TYPED_TEST(CovarianceCommand, EveryStepEqualsTheDenseInverseOfWhatIsKnown) {
  constexpr int B = TypeParam::kDof;
  for (const bool priors : {false, true}) {
    this->MakeGraph(priors ? 8 : 7, 0, priors);
    for (const Choice& choice : kChoices) {
      this->Succeed(
          "solve in.g2o --mode incremental --covariances all-steps --covariance-output steps.csv "
          "--stats stats.json" +
          choice.Options());
      const auto rows = CsvRows(this->Read("steps.csv"));
      const auto& poses = this->graph_.Poses();
      ASSERT_EQ(rows.size(), poses.size());
      PoseGraph<TypeParam> known;
      for (std::size_t k = 0; k < poses.size(); ++k) {
        ASSERT_EQ(rows[k].size(), std::size_t(9 + B * B));
        EXPECT_EQ(rows[k][0], std::to_string(k + 1));
        EXPECT_EQ(rows[k][1], std::to_string(k + 1));
        EXPECT_EQ(rows[k][8], std::to_string(poses[k].id.value));
        known.AddPose(poses[k].id, poses[k].T_world_body);
        for (const auto& node : this->graph_.Factors()) {
          const FactorPoses ends = PosesOf(node.factor);
          const PoseId last = std::max(ends.first, ends.second);
          if (last == poses[k].id) known.AddFactor(node.factor);
        }
        const MatrixXd Sigma = testing::Inverse(testing::MakeDenseSystem(known, internal::ValuesOf(known)).H);
        const MatrixXd M = Convention(*poses[k].T_world_body, choice.frame, choice.order);
        EXPECT_LT(RelativeError(LastCells(rows[k], B), M * Sigma.bottomRightCorner<B, B>() * M.transpose()), 1e-6) << k;
        double position = 0, rotation = 0;
        for (Eigen::Index i = 0; i < Sigma.rows(); ++i) (i % B < TypeParam::kDim ? position : rotation) += Sigma(i, i);
        EXPECT_NEAR(std::stod(rows[k][6]), position, 1e-6 * position);
        EXPECT_NEAR(std::stod(rows[k][7]), rotation, 1e-6 * rotation);
      }
      this->Succeed("solve in.g2o --covariances last --covariance-output last.csv" + choice.Options());
      EXPECT_LT(RelativeError(LastCells(rows.back(), B), LastCells(CsvRows(this->Read("last.csv")).at(0), B)), 1e-6);
      const auto stats = this->JsonFile("stats.json");
      std::size_t count = 0;
      for (const auto& [path, times] : stats["covariance_paths"].items()) {
        count += times.template get<std::size_t>();
        EXPECT_EQ(times,
                  std::count_if(rows.begin(), rows.end(), [&name = path](const auto& r) { return r[2] == name; }));
      }
      EXPECT_EQ(count, rows.size());
      EXPECT_GT(stats["seconds"]["covariance"], 0);
    }
  }
}

TYPED_TEST(CovarianceCommand, AStepMayBringNoPose) {
  this->MakeGraph(9);
  const Outcome outcome = this->Succeed("solve in.g2o --mode incremental --every edge --covariances all-steps --quiet");
  EXPECT_EQ(outcome.err, "");
  EXPECT_EQ(
      outcome.out.rfind("step,poses,path,columns,drift,seconds,position_variance_sum,rotation_variance_sum,id,x_x", 0),
      0u);
  const auto rows = CsvRows(outcome.out);
  EXPECT_EQ(rows.size(), this->graph_.Factors().size());
  EXPECT_EQ(rows.back()[1], std::to_string(this->graph_.Poses().size()));
}

class CovarianceCommandErrors : public testing::CommandTest {
 protected:
  void SetUp() override {
    testing::CommandTest::SetUp();
    Write("in.g2o",
          "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 -5 2 0 0\n"
          "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 -5 1 0 0 1 0 0 1 0 1\n");
  }
};

TEST_F(CovarianceCommandErrors, UsageErrorsExitWith2) {
  const std::string run = "covariance in.g2o ";
  ExpectFailure("covariance", 2, "FILE is required");
  ExpectFailure(run + "--joint", 2, "--joint: needs --ids");
  ExpectFailure(run + "--ids 0,1,0 --joint", 2, "--joint: pose 0 is named twice");
  ExpectFailure(run + "--relative 1 1", 2, "--relative: needs two distinct poses");
  ExpectFailure(run + "--relative 0 1 --ids 0", 2, "--relative: excludes --ids");
  ExpectFailure(run + "--relative 0 1 --joint", 2, "--joint: needs --ids");
  ExpectFailure(run + "--relative 0", 2, "--relative: ");
  ExpectFailure(run + "--relative 0 one", 2, "--relative: 'one' is not the id of a pose");
  for (const std::string ids : {"x", "1,,0", "1,", "''", "1.5", "0x1", "9223372036854775808"}) {
    ExpectFailure(run + "--ids " + ids, 2, "is not the id of a pose, which is a whole number");
  }
  ExpectFailure(run + "--ids 0 1", 2, "unexpected argument 1");
  ExpectFailure(run + "--id 0", 2, "did you mean --ids?");
  ExpectFailure(run + "--frame map", 2, "map not in {body,world,world-axes}");
  ExpectFailure(run + "--order phi", 2, "phi not in {translation-first,rotation-first}");
  ExpectFailure("covarianc in.g2o", 2, "did you mean covariance?");
  ExpectFailure("solve in.g2o --covariances all-steps", 2, "--covariances: all-steps needs --mode incremental");
  ExpectFailure("solve in.g2o --mode incremental --covariances all-steps --steps -", 2, "takes one table");
  ExpectFailure("solve in.g2o --frame world", 2, "--frame: needs --covariances");
  ExpectFailure("solve in.g2o --order rotation-first", 2, "--order: needs --covariances");
}

TEST_F(CovarianceCommandErrors, AHugeJointIsRefused) {
  std::string graph, ids = "0";
  for (int k = 1; k <= 1000; ++k) {
    graph += "EDGE_SE2 " + std::to_string(k - 1) + ' ' + std::to_string(k) + " 1 0 0 1 0 0 1 0 1\n";
    ids += ',' + std::to_string(k);
  }
  Write("chain.g2o", graph);
  ExpectFailure("covariance chain.g2o --solve --joint --ids " + ids, 2,
                "1001 poses make a matrix of 3003 rows; at most 1000 poses");
  EXPECT_EQ(Json("covariance chain.g2o --solve --json --ids " + ids).size(), 1001u) << "their marginals are";
}

TEST_F(CovarianceCommandErrors, BadInputExitsWith1) {
  ExpectFailure("covariance missing.g2o", 1, "missing.g2o: the file does not exist");
  for (const std::string query : {"--ids 7", "--ids 0,7 --joint", "--relative 0 7", "--relative 7 0"}) {
    ExpectFailure("covariance in.g2o " + query, 1, "in.g2o: pose 7 is not in the graph");
  }
  Succeed("covariance in.g2o --ids -5,0");
  Succeed("covariance in.g2o --relative -5 0");
  Write("edges.g2o", "VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
  ExpectFailure("covariance edges.g2o", 1, "edges.g2o: pose 1 has no value in the file; --solve computes the values");
  Succeed("covariance edges.g2o --solve");
  Write("bad.g2o", "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 zero 0\n");
  ExpectFailure("covariance bad.g2o", 1, "bad.g2o:2: ");
}

// Squares beyond the range of doubles.
TEST_F(CovarianceCommandErrors, ANumericalFailureExitsWith3) {
  Write("in.g2o",
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1e200 0 0\n"
        "EDGE_SE2 0 1 1e200 0 0 1 0 0 1 0 1\nEDGE_SE2 0 1 -1e200 0 0 1 0 0 1 0 1\n");
  for (const std::string solve : {"", " --solve"}) {
    ExpectFailure("covariance in.g2o --output out" + solve, 3, "in.g2o: ");
  }
  EXPECT_FALSE(Exists("out"));
}

TEST_F(CovarianceCommandErrors, RotationInformationIsObeyed) {
  Write("turn.g2o",
        "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\n"
        "EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4\n");
  const auto rx = [&](const std::string& meaning) {
    const std::string run = "covariance turn.g2o --relative 0 1 --json --rotation-information ";
    return ToMatrix(Json(run + meaning)["covariance"])(3, 3);
  };
  EXPECT_NEAR(rx("quaternion"), 1, 1e-9);
  EXPECT_NEAR(rx("radians"), 0.25, 1e-9);
}

}  // namespace
}  // namespace terse
