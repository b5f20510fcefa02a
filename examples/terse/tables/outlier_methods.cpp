#include "tables/outlier_methods.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <stdexcept>

#include "run/run_statistics.h"
#include "terse/compact/compact_graph.h"
#include "terse/compact/contradicted_loops.h"
#include "terse/core/number_text.h"
#include "terse/core/replay.h"
#include "terse/core/words.h"

namespace terse {
namespace {

// Since it was made.
class Limit {
 public:
  explicit Limit(double most_seconds) : most_(most_seconds) {}
  double Seconds() const { return SecondsNow() - start_; }
  bool IsOver() const { return most_ > 0 && Seconds() > most_; }
  void Check() const {
    if (IsOver()) throw std::runtime_error("stopped after " + Shortest(most_) + " s");
  }

 private:
  double most_, start_ = SecondsNow();
};

template <class Pose>
class MethodRun {
 public:
  MethodRun(const OutlierMethod& method, const OutlierScene<Pose>& scene, const Contaminated<Pose>& with,
            double most_seconds)
      : method_(method), scene_(scene), with_(with), limit_(most_seconds) {}

  OutlierMap Run() {
    switch (method_.mode) {
      case OutlierMethod::Mode::kBatch: Batch(); break;
      case OutlierMethod::Mode::kIncremental: Incremental(); break;
      case OutlierMethod::Mode::kCompact: Compact(); break;
      case OutlierMethod::Mode::kChance:
      case OutlierMethod::Mode::kOdometry: WithoutJudgement(); break;
    }
    return std::move(out_);
  }

 private:
  RobustOptions Robust() const {
    RobustOptions robust;
    robust.kernel = method_.kernel;
    robust.width = scene_.width;
    return robust;
  }
  void TakeTrajectory(const std::vector<RecoveredPose<Pose>>& trajectory) {
    out_.seconds = limit_.Seconds();
    out_.ate = ComputeAte(scene_.graph, scene_.reference, trajectory);
  }

  void Batch() {
    BatchOptions options;
    options.robust = Robust();
    options.progress = [this](int, double) { return !limit_.IsOver(); };
    const BatchResult<Pose> result = SolveBatch(with_.graph, options);
    limit_.Check();
    if (result.termination == Termination::kNotPositiveDefinite) throw NumericalError(result.message);
    TakeTrajectory(AsTrajectory(with_.graph, result.T_world_body));
    out_.loops = CountLoops(with_.graph, with_.wrong,
                            [&](std::size_t k, FactorId) { return result.weights.empty() ? 1 : result.weights[k]; });
  }

  void Incremental() {
    IncrementalOptions options;
    options.robust = Robust();
    IncrementalSolver<Pose> solver(options);
    Replay<Pose>(with_.graph, {}, solver, [&](const ReplayStep& step) {
      out_.step_seconds.push_back(step.report.seconds);
      limit_.Check();
      return true;
    });
    if (method_.finish) solver.Finish();
    TakeTrajectory(AsTrajectory(solver.Graph(), solver.Estimates()));
    out_.loops = CountLoops(solver.Graph(), with_.wrong, [&](std::size_t, FactorId id) { return solver.WeightOf(id); });
  }

  void WithoutJudgement() {
    std::vector<FactorId> left_out;
    if (!with_.wrong.empty()) {
      const std::vector<FactorId> loops = LoopFactors(with_.graph);
      const double wrong = static_cast<double>(with_.wrong.size()) / static_cast<double>(loops.size());
      std::mt19937_64 random(with_.seed);
      for (const FactorId id : loops) {
        const bool is_drawn = std::ldexp(static_cast<double>(random() >> 11), -53) < wrong;
        if (is_drawn || method_.mode == OutlierMethod::Mode::kOdometry) left_out.push_back(id);
      }
    }
    BatchOptions options;
    options.progress = [this](int, double) { return !limit_.IsOver(); };
    const BatchResult<Pose> result = SolveBatch(WithoutFactors(with_.graph, left_out), options);
    limit_.Check();
    TakeTrajectory(AsTrajectory(with_.graph, result.T_world_body));
    out_.loops = CountLoops(with_.graph, with_.wrong, [&](std::size_t, FactorId id) {
      return std::binary_search(left_out.begin(), left_out.end(), id) ? 0 : 1;
    });
  }

  CompactRun<Pose> MakeCompactRun() const {
    const AfterStep<Pose> watch = [this](const CompactPoseSlam<Pose>&, const Decision&, double) { limit_.Check(); };
    CompactOptions<Pose> options;
    options.strategy = method_.strategy.value_or(options.strategy);
    const InformationCalibration information = CalibrateInformation(with_.graph);
    options = OptionsFor(Robust(), information, std::move(options));
    BatchOptions batch;
    batch.progress = [this](int, double) { return !limit_.IsOver(); };
    LoopJury<Pose> jury(with_.graph, information, options.solver.robust, batch);
    return CompactGraph(jury, std::move(options), watch);
  }

  void Compact() {
    const CompactRun<Pose> run = MakeCompactRun();
    TakeTrajectory(run.slam.Trajectory());
    out_.step_seconds = run.step_seconds;
    out_.loops.wrong_loops = static_cast<int>(with_.wrong.size());
    out_.loops.true_loops = static_cast<int>(LoopFactors(with_.graph).size() - with_.wrong.size());
    // Whose factors they are part of.
    std::map<std::int64_t, double> weights;
    for (const auto& edge : run.slam.Export().edges) {
      const double weight = run.slam.Solver().WeightOf(edge.factor);
      weights[edge.factor.value] = weight;
      for (const auto& part : edge.parts) weights[part.id.value] = weight;
    }
    for (const Decision& decision : run.decisions) {
      for (const Candidate& c : decision.candidates) {
        if (!c.accepted) continue;
        const auto weight = c.factor ? weights.find(c.factor->value) : weights.end();
        if (weight != weights.end() && weight->second < 0.5) continue;
        const bool is_wrong = with_.wrong.count(PairOf(c.carried_from.value_or(c.id), decision.id)) != 0;
        ++(is_wrong ? out_.loops.wrong_kept : out_.loops.true_kept);
      }
    }
  }

  const OutlierMethod& method_;
  const OutlierScene<Pose>& scene_;
  const Contaminated<Pose>& with_;
  Limit limit_;
  OutlierMap out_;
};

}  // namespace

const std::vector<OutlierMethod>& OutlierMethods() {
  using Mode = OutlierMethod::Mode;
  static const std::vector<OutlierMethod> methods = [] {
    std::vector<OutlierMethod> out;
    for (const auto& [word, kernel] : Words<RobustKernel>::kAll) {
      out.push_back({std::string("batch-") + word, Mode::kBatch, kernel});
    }
    for (const auto& [word, kernel] : Words<RobustKernel>::kAll) {
      out.push_back({std::string("incremental-") + word, Mode::kIncremental, kernel});
    }
    out.push_back({"incremental-gnc-finish", Mode::kIncremental, RobustKernel::kGnc, true});
    out.push_back({"compact", Mode::kCompact, RobustKernel::kGnc});
    out.push_back({"compact-none", Mode::kCompact, RobustKernel::kNone});
    out.push_back({"compact-fpfl", Mode::kCompact, RobustKernel::kGnc, false, Strategy::kFpfl});
    out.push_back({"compact-fpfl-none", Mode::kCompact, RobustKernel::kNone, false, Strategy::kFpfl});
    out.push_back({"chance", Mode::kChance});
    out.push_back({"odometry", Mode::kOdometry});
    return out;
  }();
  return methods;
}

const OutlierMethod& OutlierMethodOf(const std::string& name) {
  for (const OutlierMethod& method : OutlierMethods()) {
    if (method.name == name) return method;
  }
  throw std::invalid_argument("no method " + name);
}

template <class Pose>
OutlierMap RunOutlierMethod(const OutlierMethod& method, const OutlierScene<Pose>& scene,
                            const Contaminated<Pose>& with, double most_seconds) {
  return MethodRun<Pose>(method, scene, with, most_seconds).Run();
}

template OutlierMap RunOutlierMethod(const OutlierMethod&, const OutlierScene<SE2>&, const Contaminated<SE2>&, double);
template OutlierMap RunOutlierMethod(const OutlierMethod&, const OutlierScene<SE3>&, const Contaminated<SE3>&, double);

}  // namespace terse
