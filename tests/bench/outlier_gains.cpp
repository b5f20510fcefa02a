#include "outlier_gains.h"

#include <algorithm>
#include <cmath>

#include "bench_report.h"
#include "terse/compact/information.h"
#include "terse/compact/innovation.h"
#include "terse/core/chi_square.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse::bench {
namespace {

struct LoopValue {
  double gain = 0, innovation = 0;
  bool in_range = false;               // of the thresholds from the clean graph
  bool in_contaminated_range = false;  // of those from the graph with its wrong loops
};
struct LoopValues {
  std::vector<LoopValue> of_true, of_wrong;
};

template <class Pose>
class GainRun {
 public:
  GainRun(const Contaminated<Pose>& with, const Thresholds<Pose>& clean, const Thresholds<Pose>& contaminated)
      : wrong_(with.wrong), clean_(clean), contaminated_(contaminated), replay_(with.graph) {}

  LoopValues Run() {
    const Registration<Pose> registration = replay_.AsRegistration();
    for (const auto& input : replay_.Inputs()) {
      GraphUpdate<Pose> arrival, links;
      arrival.poses.push_back({input.id, input.odometry ? std::nullopt : input.T_world_body, input.fixed});
      if (input.odometry) arrival.factors.push_back(*input.odometry);
      solver_.Update(arrival);
      for (const PoseId id : *input.linkable) {
        const RelativePoseFactor<Pose> link = *registration(id, input.id);
        const bool is_wrong = wrong_.count(PairOf(id, input.id)) != 0;
        (is_wrong ? out_.of_wrong : out_.of_true).push_back(Judge(id, input.id, link));
        if (!is_wrong) links.factors.push_back(link);
      }
      if (!links.factors.empty()) solver_.Update(links);
    }
    return std::move(out_);
  }

 private:
  LoopValue Judge(PoseId id, PoseId current, const RelativePoseFactor<Pose>& link) const {
    const UncertainPose<Pose> known{solver_.Estimate(id).Inverse() * solver_.Estimate(current),
                                    marginals_.Relative(id, current)};
    const UncertainPose<Pose> measured = SeenFrom(id, link);
    const Displacement<Pose> displacement = ComputeDisplacement(known);
    const auto in_range = [&](const Thresholds<Pose>& t) {
      return RangeProbabilities<Pose>(displacement, t.range).minCoeff() > t.probability;
    };
    return {InformationGain<Pose::kDof>(known.covariance, measured.covariance), InnovationDistance(known, measured),
            in_range(clean_), in_range(contaminated_)};
  }

  const std::set<PosePair>& wrong_;
  const Thresholds<Pose>&clean_, &contaminated_;
  GraphReplay<Pose> replay_;
  IncrementalSolver<Pose> solver_;
  IncrementalMarginals<Pose> marginals_{solver_};
  LoopValues out_;
};

double Percentile(std::vector<double> values, double share) {
  const auto nth = values.begin() + std::lround(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

std::vector<double> Gains(const std::vector<LoopValue>& loops) {
  std::vector<double> out;
  for (const LoopValue& loop : loops) out.push_back(loop.gain);
  std::sort(out.begin(), out.end());
  return out;
}

// That a wrong loop drawn at random has a higher gain than a true one (the area under the ROC curve).
double ProbabilityOfHigherGain(const LoopValues& values) {
  const std::vector<double> of_true = Gains(values.of_true);
  double sum = 0;
  for (const LoopValue& loop : values.of_wrong) {
    const auto range = std::equal_range(of_true.begin(), of_true.end(), loop.gain);
    sum += static_cast<double>(range.first - of_true.begin()) + 0.5 * static_cast<double>(range.second - range.first);
  }
  return sum / (static_cast<double>(of_true.size()) * static_cast<double>(values.of_wrong.size()));
}

template <class Is>
std::string Share(const std::vector<LoopValue>& loops, const Is& is) {
  const auto count = std::count_if(loops.begin(), loops.end(), is);
  return Format("%.1f", 100 * static_cast<double>(count) / static_cast<double>(loops.size()));
}

}  // namespace

std::string GainHeader() {
  return "| graph | loops | number | gain: 10 % | 50 % | 90 % | above a true one | above g_loop, % | refused, % | in "
         "range, "
         "% "
         "| in range of contaminated, % | in range, above g_loop, not refused, % |\n"
         "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n";
}

template <class Pose>
std::string GainRows(const std::string& name, const Contaminated<Pose>& with, const Thresholds<Pose>& clean,
                     const Thresholds<Pose>& contaminated) {
  const LoopValues values = GainRun<Pose>(with, clean, contaminated).Run();
  const double most = ChiSquareQuantile(kInnovationQuantile, Pose::kDof);
  std::string out;
  for (const bool is_wrong : {false, true}) {
    const auto& loops = is_wrong ? values.of_wrong : values.of_true;
    const std::vector<double> gains = Gains(loops);
    const auto informative = [&](const LoopValue& l) { return l.gain > clean.min_loop_gain; };
    const auto refused = [&](const LoopValue& l) { return !(l.innovation <= most); };
    out += is_wrong ? "| | wrong | " : "| " + name + " | true | ";
    out += std::to_string(loops.size());
    for (const double share : {0.1, 0.5, 0.9}) out += " | " + Format("%.2f", Percentile(gains, share));
    out += " | " + (is_wrong ? Format("%.3f", ProbabilityOfHigherGain(values)) : std::string());
    out += " | " + Share(loops, informative) + " | " + Share(loops, refused) + " | " +
           Share(loops, [](const LoopValue& l) { return l.in_range; }) + " | " +
           Share(loops, [](const LoopValue& l) { return l.in_contaminated_range; }) + " | " +
           Share(loops, [&](const LoopValue& l) { return l.in_range && informative(l) && !refused(l); }) + " |\n";
  }
  return out;
}

template std::string GainRows(const std::string&, const Contaminated<SE2>&, const Thresholds<SE2>&,
                              const Thresholds<SE2>&);
template std::string GainRows(const std::string&, const Contaminated<SE3>&, const Thresholds<SE3>&,
                              const Thresholds<SE3>&);

}  // namespace terse::bench
