#include "terse/covariance/information_scale.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "information_kinds.h"
#include "information_sample.h"
#include "residual_group.h"
#include "terse/core/at.h"
#include "terse/core/batch_solver.h"
#include "terse/core/chi_square.h"
#include "terse/core/error.h"
#include "terse/core/initial_values.h"
#include "terse/core/linear_factor.h"
#include "terse/core/residual.h"
#include "terse/core/robust.h"
#include "terse/covariance/information_probe.h"
#include "terse/covariance/scale_evidence.h"
#include "terse/covariance/short_cycles.h"

namespace terse {
namespace {

using internal::At;
using internal::BlockSquares;
using internal::InformationSample;
using internal::ProbeTerm;
using internal::ResidualGroup;
using std::size_t;

constexpr double kStandsOut = 9;      // times the other loops' squares: loses weight
constexpr double kTrueLoop = 0.9999;  // share of true loops within the width of the robust kernel
constexpr int kStepsTogether = 2;
constexpr int kFirstIterations = 60;  // of truncated least squares
constexpr double kTolerance = 1e-4;   // relative, of chi2
// Logarithm. Scales that moved by less keep the loops that are in as a start; those that differ by less from the best
// ones are not tried besides.
constexpr double kMovesLittle = 0.3;
// Standard deviations that are stated too small by less may be left.
constexpr double kMayBeLeft = 2;
// Over long ways odometry may be worse than over short cycles.
constexpr double kFarLargerThanCycles = 2.5;
constexpr double kRoomBesideCopies = 15;
// Where so few loops close too few short cycles, smaller scales than the residuals' are tried in turn.
constexpr long kLeastLoops = 4, kMostLoops = 200;
constexpr std::array<double, 3> kTriedShares = {1.0 / 4, 1.0 / 16, 1.0 / 64};
// Somebody's guess may be right but for one factor: these are tried too, up to what residuals say.
constexpr std::array<double, 6> kOfStated = {64, 16, 4, 1.0 / 4, 1.0 / 16, 1.0 / 64};
constexpr double kLeastRedundancy = 5;
constexpr double kMostLogError = 0.35;
// No sensor is better: of a step, and radians. Residuals below are rounding, or measurements that are copies of one
// another.
constexpr double kFloorOfStep = 0.003, kFloorTurn = 5e-4;

// Translation and rotation of odometry, then of loops.
constexpr int kGroups = 4;
int GroupOf(bool is_loop, bool is_rotation) { return (is_loop ? 2 : 0) + (is_rotation ? 1 : 0); }
template <class Value>
using ByGroup = std::array<Value, kGroups>;

template <class Pose>
double Chi2Of(const PoseGraph<Pose>& graph, const std::vector<Pose>& values) {
  double cost = 0;
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const Factor<Pose>& factor = node.factor;
    const Vector<Pose::kDof> r =
        Residual(factor, values[At(graph.IndexOf(ends.first))], values[At(graph.IndexOf(ends.second))]);
    cost += r.dot(std::get<RelativePoseFactor<Pose>>(factor).information * r);
  }
  return cost;
}

// The cheapest of composed and chordal values.
template <class Pose>
std::vector<Pose> StartOf(const PoseGraph<Pose>& graph) {
  std::vector<Pose> composed = ComputeInitialValues(graph, InitialValues::kCompose);
  try {
    std::vector<Pose> chordal = ComputeInitialValues(graph, InitialValues::kChordal);
    if (Chi2Of(graph, chordal) < Chi2Of(graph, composed)) return chordal;
  } catch (const NumericalError&) {  // singular to rounding: the composed values will do
  }
  return composed;
}

template <class Pose>
class Estimator {
 public:
  Estimator(const PoseGraph<Pose>& graph, const EstimateOptions& options)
      : options_(options), stated_(DescribeInformation(graph)), sample_(internal::TakeSample(graph, options)) {
    out_.poses = static_cast<long>(sample_.graph.Poses().size());
    out_.edges = static_cast<long>(sample_.terms.size());
    out_.loop_edges = sample_.loops;
    out_.agreeing_loops = internal::ShareOfAgreeingLoops(sample_);
    for (const bool is_loop : {false, true}) {
      const StatedKind& kind = is_loop && stated_.loops.edges > 0 ? stated_.loops : stated_.odometry;
      // In 2D and 3D alike a step of zero length (a robot that turns on the spot) leaves the floor to rotation.
      floor_[At(GroupOf(is_loop, false))] = Ratio(kFloorOfStep * stated_.median_step_m, kind.translation_m.median);
      floor_[At(GroupOf(is_loop, true))] = Ratio(kFloorTurn, kind.rotation_rad.median);
    }
  }

  InformationEstimate Run() {
    const double redundancy = static_cast<double>(Pose::kDof) * static_cast<double>(out_.edges - (out_.poses - 1));
    if (redundancy <= 0) {
      out_.failure = "no loops: nothing contradicts the odometry";
      return out_;
    }
    Attempt best = AttemptFrom(std::nullopt);
    if (best.out.failure.empty()) TryOthers(best);
    best.out.odometry = {best.found[0].estimate, best.found[1].estimate};
    best.out.loops = {best.found[2].estimate, best.found[3].estimate};
    return best.out;
  }

 private:
  struct Found {
    ScaleEstimate estimate;
    double step = 0;  // of the logarithm of the scale, the last
  };
  struct Attempt {
    ByGroup<Found> found;
    ByGroup<double> log_scale;
    InformationEstimate out;
    bool is_told_apart = false;  // by truncated least squares
  };

  // From the information as stated, without any doubt of loops; or from a scale, at which truncated least squares tells
  // which ones are wrong.
  Attempt AttemptFrom(const std::optional<KindScale>& scale) {
    found_ = {};
    InformationEstimate& out = out_;
    out.failure.clear();
    out.loops_left_out = 0;
    out.has_copies = false;
    for (auto& term : sample_.terms) term.weight = 1;
    // What agrees better than any sensor is a copy of something else, and says nothing on how good the rest is: all
    // count then, and odometry cannot be told from loops.
    if (scale && IsBelowFloor(*scale)) {
      out.has_copies = true;
    } else {
      start_ = scale ? Composed() : StartOf(sample_.graph);  // wrong loops bend a relaxation
      Iterate(true, scale);
      for (const Found& f : found_) out.has_copies = out.has_copies || f.estimate.at_floor;
    }
    if (out.failure.empty() && out.has_copies) {
      LeaveOutBesideCopies(scale ? RoomAround(*scale) : KindScale(), scale ? 1 : 0.5);
      if (!scale || out.loops_left_out > 0) {
        Iterate(false, std::nullopt);
      } else {
        out.failure = "no loop is wrong";
      }
    }
    return {found_, log_scale_, out, is_suspicious_ && scale};
  }

  // Residuals far larger than short cycles tell come of odometry that drifts more than its steps say, or of so many
  // wrong loops that they bend all residuals and none stands out. Then short cycles may tell the scale, or the
  // information is right as stated.
  void TryOthers(Attempt& best) {
    const auto cycles = internal::ScaleOfShortCycles<Pose>(internal::ShortCycles(
        internal::ForwardEdges(sample_.terms, sample_.is_loop),
        internal::OdometryChain<Pose>(internal::ForwardEdges(sample_.terms), sample_.graph.Poses().size())));
    double over_stated = 0, over_cycles = 0;
    const KindScale least = cycles ? AboveFloor(*cycles) : KindScale{0, 0};
    for (int g = 0; g < kGroups; ++g) {
      const ScaleEstimate& found = best.found[At(g)].estimate;
      if (!found.determined) continue;
      over_stated = std::max(over_stated, found.sigma_factor);
      const double of_cycles = g % 2 == 0 ? least.translation : least.rotation;
      if (of_cycles > 0) over_cycles = std::max(over_cycles, found.sigma_factor / of_cycles);
    }
    const bool bends = !cycles || over_cycles > kFarLargerThanCycles;
    Lowest lowest = {LeastCost(best.log_scale), true};
    if (over_stated > kMayBeLeft && (bends || out_.agreeing_loops > internal::kManyAgree)) Try({1, 1}, best, lowest);
    if (!bends) return;
    if (cycles) Try(*cycles, best, lowest);
    const KindScale first = {best.found[0].estimate.sigma_factor, best.found[1].estimate.sigma_factor};
    if (!cycles && sample_.loops >= kLeastLoops && sample_.loops <= kMostLoops) {
      for (const double share : kTriedShares) {
        const KindScale start = {share * first.translation, share * first.rotation};
        Try(start, best, lowest);
        if (IsBelowFloor(start)) break;  // all of these are the same
      }
    }
    for (const double factor : kOfStated) {
      if (factor < over_stated && !IsBelowFloor({factor, factor})) Try({factor, factor}, best, lowest);
    }
  }

  // Of the best attempt. To solve for it costs more than to know what it is not below.
  struct Lowest {
    double cost = 0;
    bool is_bound = false;
  };
  // Solves for it where the bound does not decide.
  bool IsLower(double cost, const Attempt& best, Lowest& lowest) const {
    if (lowest.is_bound && cost >= lowest.cost) lowest = {CostOf(best), false};
    return cost < lowest.cost;
  }

  // Takes the attempt from there if it is more probable than the best one. Of a few loops, some of them wrong,
  // residuals may take one of translation and rotation to its floor and leave all to the other: where that is less
  // probable, the scales that it began with are better.
  void Try(const KindScale& start, Attempt& best, Lowest& lowest) {
    constexpr double kNone = std::numeric_limits<double>::infinity();
    const ByGroup<double> log_start = LogScales(start);
    const bool is_below = IsBelowFloor(start);
    told_apart_.reset();
    double at_start = kNone;
    if (!is_below) {
      if (best.is_told_apart && AreNear(log_start, best.log_scale)) return;
      if (!IsLower(LeastCost(log_start), best, lowest)) return;
      told_apart_ = SolveAt(log_start);
      at_start = CostOf(log_start, *told_apart_);
      if (!IsLower(at_start, best, lowest)) return;
    }
    Attempt other = AttemptFrom(start);
    const auto is_of_copies = [](const Found& f) { return f.estimate.at_floor; };
    // Copies alone tell nothing.
    const bool fails = !other.out.failure.empty() || std::all_of(other.found.begin(), other.found.end(), is_of_copies);
    double cost = fails ? kNone : CostOf(other);
    if (std::any_of(other.found.begin(), other.found.end(), is_of_copies) && at_start < cost) {
      cost = at_start;
      other.out.failure.clear();
      other.log_scale = log_start;
      other.is_told_apart = true;
      for (int g = 0; g < kGroups; ++g) {
        other.found[At(g)].estimate.sigma_factor = std::exp(other.log_scale[At(g)]);
        other.found[At(g)].estimate.at_floor = false;
      }
    }
    if (cost == kNone || !IsLower(cost, best, lowest)) return;
    lowest = {cost, false};
    other.out.normalized_chi2 = best.out.normalized_chi2;
    best = std::move(other);
  }

  static ByGroup<double> LogScales(const KindScale& scale) {
    const double t = std::log(scale.translation), r = std::log(scale.rotation);
    return {t, r, t, r};
  }

  // Where truncated least squares comes to at these scales.
  BatchResult<Pose> SolveAt(const ByGroup<double>& log_scale) const {
    const PoseGraph<Pose> graph = GraphOf(ScaledTerms(log_scale));
    return SolveBatch(graph, Composed(), ToldApart(graph));
  }
  double CostOf(const ByGroup<double>& log_scale, const BatchResult<Pose>& solved) const {
    if (solved.cholesky.Variables() == 0) return std::numeric_limits<double>::infinity();
    return internal::CostOfScales(ScaledTerms(log_scale), sample_.is_loop, solved);
  }
  double CostOf(const Attempt& attempt) const { return CostOf(attempt.log_scale, SolveAt(attempt.log_scale)); }
  double LeastCost(const ByGroup<double>& log_scale) const {
    return internal::LeastCostOfScales(ScaledTerms(log_scale), sample_.is_loop);
  }

  static bool AreNear(const ByGroup<double>& a, const ByGroup<double>& b) {
    double largest = 0;
    for (int g = 0; g < kGroups; ++g) largest = std::max(largest, std::abs(a[At(g)] - b[At(g)]));
    return largest < kMovesLittle;
  }

  PoseGraph<Pose> GraphOf(const std::vector<ProbeTerm<Pose>>& terms) const {
    PoseGraph<Pose> graph;
    for (const auto& node : sample_.graph.Poses()) graph.AddPose(node.id);
    for (const auto& term : terms) graph.AddFactor(term.factor);
    return graph;
  }

  std::vector<Pose> Composed() const { return ComputeInitialValues(sample_.graph, InitialValues::kCompose); }

  std::vector<ProbeTerm<Pose>> ScaledTerms(const ByGroup<double>& log_scale) const {
    std::vector<ProbeTerm<Pose>> terms = sample_.terms;
    for (size_t k = 0; k < terms.size(); ++k) {
      const KindScale scale{std::exp(log_scale[At(GroupOf(sample_.is_loop[k], false))]),
                            std::exp(log_scale[At(GroupOf(sample_.is_loop[k], true))])};
      terms[k].factor.information = internal::Scaled<Pose>(terms[k].factor.information, scale);
    }
    return terms;
  }

  static double Ratio(double floor, double stated) { return stated > 0 ? floor / stated : 0; }

  double LargestStep() const {
    double largest = 0;
    for (const Found& f : found_) largest = std::max(largest, std::abs(f.step));
    return largest;
  }

  KindScale AboveFloor(const KindScale& scale) const {
    return {std::max(scale.translation, std::min(floor_[0], floor_[2])),
            std::max(scale.rotation, std::min(floor_[1], floor_[3]))};
  }
  bool IsBelowFloor(const KindScale& scale) const {
    const KindScale above = AboveFloor(scale);
    return above.translation > scale.translation || above.rotation > scale.rotation;
  }
  KindScale RoomAround(const KindScale& scale) const {
    if (!IsBelowFloor(scale)) return scale;
    const KindScale above = AboveFloor(scale);
    const auto room = [](double least) { return std::max(least, std::min(kRoomBesideCopies * least, 1.0)); };
    return {room(above.translation), room(above.rotation)};
  }

  // Beside copies every loop that is not one stands out, so that none is taken for wrong but what truncated least
  // squares leaves out at a scale with room for those, if that is less than a share.
  void LeaveOutBesideCopies(const KindScale& scale, double most) {
    for (auto& term : sample_.terms) term.weight = 1;
    out_.loops_left_out = 0;
    const PoseGraph<Pose> graph = GraphOf(ScaledTerms(LogScales(scale)));
    const BatchResult<Pose> result = SolveBatch(graph, Composed(), ToldApart(graph));
    if (result.cholesky.Variables() == 0) return;
    const auto is_out = [](double weight) { return weight < 0.5; };
    const long left_out = std::count_if(result.weights.begin(), result.weights.end(), is_out);
    if (left_out == 0 || static_cast<double>(left_out) >= most * static_cast<double>(out_.loop_edges)) return;
    out_.loops_left_out = left_out;
    for (size_t k = 0; k < sample_.terms.size(); ++k) sample_.terms[k].weight = is_out(result.weights[k]) ? 0 : 1;
    start_ = result.T_world_body;
  }

  static RobustOptions TruncatedLeastSquares() {
    RobustOptions robust;
    robust.kernel = RobustKernel::kGnc;
    robust.width = std::sqrt(ChiSquareQuantile(kTrueLoop, Pose::kDof));
    return robust;
  }
  // By graduation: a replay trusts the information, and takes longer.
  static BatchOptions ToldApart(const PoseGraph<Pose>& graph) {
    BatchOptions solve;
    solve.max_iterations = kFirstIterations;
    solve.relative_tolerance = kTolerance;
    solve.robust = TruncatedLeastSquares();
    solve.robust_factors = LoopFactors(graph);
    return solve;
  }

  // `suspicious`: from this scale on, and some loops are taken for wrong from the first step on.
  void Iterate(bool is_robust, const std::optional<KindScale>& suspicious) {
    log_scale_ = LogScales(suspicious.value_or(KindScale()));
    is_suspicious_ = suspicious.has_value();
    steps_suspicious_ = 0;
    std::vector<Pose> values = start_;
    for (int k = 0; k < options_.max_iterations; ++k) {
      out_.iterations = k + 1;
      if (!Step(is_robust, k == 0, values)) return;
      const bool is_settled = !is_suspicious_ || steps_suspicious_ > kStepsTogether;
      if (LargestStep() < options_.tolerance && is_settled) break;
    }
  }

  // One solution at the present scales and the next scales from its residuals.
  bool Step(bool is_robust, bool is_first, std::vector<Pose>& values) {
    std::vector<ProbeTerm<Pose>> terms = ScaledTerms(log_scale_);
    PoseGraph<Pose> weighted;
    for (const auto& node : sample_.graph.Poses()) weighted.AddPose(node.id);
    for (const auto& term : terms) {
      RelativePoseFactor<Pose> with_weight = term.factor;
      if (!is_suspicious_) with_weight.information *= term.weight;
      if (is_suspicious_ || term.weight > 0) weighted.AddFactor(with_weight);
    }
    BatchOptions solve;
    if (is_suspicious_) {  // the kernel decides anew
      solve = ToldApart(weighted);
      solve.graduate = steps_suspicious_ == 0 || LargestStep() > kMovesLittle;
    }
    solve.max_iterations = is_first ? (is_suspicious_ ? kFirstIterations : 50) : 10;
    solve.relative_tolerance = kTolerance;
    const bool is_solved = is_suspicious_ && is_first && told_apart_.has_value();
    const BatchResult<Pose> result =
        is_solved ? *std::exchange(told_apart_, std::nullopt) : SolveBatch(weighted, values, solve);
    if (result.cholesky.Variables() == 0) {
      out_.failure = result.message;
      return false;
    }
    values = result.T_world_body;
    if (is_suspicious_) TakeWeights(result.weights, terms);
    const auto draws = internal::DrawResiduals(terms, values, result.cholesky, options_.draws, options_.seed);
    ByGroup<ResidualGroup> groups = Collect(terms, values, draws);
    if (is_first && is_robust && !is_suspicious_) NormalizedChi2(terms, values);
    // While it is open which loops are wrong, odometry would take them on itself.
    const bool apart = is_robust && (!is_suspicious_ || ++steps_suspicious_ > kStepsTogether);
    if (apart) {
      for (int g = 0; g < kGroups; ++g) Update(groups[At(g)], true, g);
    } else {  // one scale for odometry and loops
      for (const int g : {0, 1}) {
        groups[At(g)].Append(std::move(groups[At(g + 2)]));
        Update(groups[At(g)], is_robust, g);
        found_[At(g + 2)] = found_[At(g)];
      }
    }
    TieUndetermined();
    for (int g = 0; g < kGroups; ++g) Apply(g);
    if (is_robust && !is_suspicious_) Reweight(groups);
    return true;
  }

  ByGroup<ResidualGroup> Collect(const std::vector<ProbeTerm<Pose>>& terms, const std::vector<Pose>& values,
                                 const std::vector<std::vector<BlockSquares>>& draws) const {
    ByGroup<ResidualGroup> groups;
    for (int g = 0; g < kGroups; ++g) groups[At(g)].scalars = g % 2 == 0 ? Pose::kDim : Pose::kDof - Pose::kDim;
    for (size_t k = 0; k < terms.size(); ++k) {
      const ProbeTerm<Pose>& t = terms[k];
      const auto residual = Residual(Factor<Pose>(t.factor), values[At(t.first)], values[At(t.second)]);
      const BlockSquares squares = internal::SquaresOf<Pose>(residual, t.factor.information);
      std::vector<double> translation, rotation;
      for (const BlockSquares& d : draws[k]) {
        translation.push_back(d.translation);
        rotation.push_back(d.rotation);
      }
      groups[At(GroupOf(sample_.is_loop[k], false))].Add(squares.translation, std::move(translation), t.weight);
      groups[At(GroupOf(sample_.is_loop[k], true))].Add(squares.rotation, std::move(rotation), t.weight);
    }
    return groups;
  }

  // At the stated information, without any doubt of loops.
  void NormalizedChi2(const std::vector<ProbeTerm<Pose>>& terms, const std::vector<Pose>& values) {
    double chi2 = 0;
    for (const auto& t : terms) {
      chi2 += FactorChi2(Factor<Pose>(t.factor), values[At(t.first)], values[At(t.second)]);
    }
    out_.normalized_chi2 = chi2 / static_cast<double>(Pose::kDof * (out_.edges - (out_.poses - 1)));
  }

  void Update(const ResidualGroup& group, bool is_robust, int g) {
    Found& found = found_[At(g)];
    const auto [factor, error] = group.VarianceFactor(is_robust);
    found.estimate.redundancy = group.Redundancy();
    found.estimate.log_error = error / 2;
    found.estimate.determined =
        found.estimate.redundancy >= kLeastRedundancy && found.estimate.log_error <= kMostLogError;
    found.step = std::log(factor) / 2;
  }

  // Where residuals tell only of one kind, the other moves with it; where of neither, none does.
  void TieUndetermined() {
    for (int g = 0; g < kGroups; ++g) {
      Found& found = found_[At(g)];
      const Found& other = found_[At((g + 2) % kGroups)];
      if (found.estimate.determined) continue;
      found.step = other.estimate.determined ? log_scale_[At((g + 2) % kGroups)] + other.step - log_scale_[At(g)]
                                             : -log_scale_[At(g)];
    }
  }

  void Apply(int g) {
    Found& found = found_[At(g)];
    double next = log_scale_[At(g)] + found.step;
    found.estimate.at_floor = floor_[At(g)] > 0 && next < std::log(floor_[At(g)]);
    if (found.estimate.at_floor) next = std::log(floor_[At(g)]);
    found.step = next - log_scale_[At(g)];
    log_scale_[At(g)] = next;
    found.estimate.sigma_factor = std::exp(next);
  }

  // Loops whose squares stand out of those of the other loops. A floor counts as if the others were at least so large.
  void Reweight(const ByGroup<ResidualGroup>& groups) {
    const ResidualGroup &translation = groups[2], &rotation = groups[3];
    const auto bulk = [&](const ResidualGroup& group, int g) {
      std::vector<double> drawn;
      for (const auto& draws : group.drawn) drawn.insert(drawn.end(), draws.begin(), draws.end());
      const double typical = internal::Median(group.squares) / internal::Median(std::move(drawn));
      return found_[At(g)].estimate.at_floor ? std::max(typical, std::exp(2 * found_[At(g)].step)) : typical;
    };
    const double t = bulk(translation, 2), r = bulk(rotation, 3);
    size_t loop = 0;
    out_.loops_left_out = 0;
    for (size_t k = 0; k < sample_.terms.size(); ++k) {
      if (!sample_.is_loop[k]) continue;
      const double out_by = std::max(translation.squares[loop] / t, rotation.squares[loop] / r) / kStandsOut;
      sample_.terms[k].weight = out_by > 1 ? 1 / (out_by * out_by) : 1;
      out_.loops_left_out += sample_.terms[k].weight < 0.5;
      ++loop;
    }
    is_suspicious_ = out_.loops_left_out > 0;
  }

  void TakeWeights(const std::vector<double>& weights, std::vector<ProbeTerm<Pose>>& terms) {
    out_.loops_left_out = 0;
    for (size_t k = 0; k < terms.size(); ++k) {
      terms[k].weight = sample_.terms[k].weight = weights[k];
      out_.loops_left_out += weights[k] < 0.5;
    }
  }

  const EstimateOptions options_;
  const StatedInformation stated_;
  InformationSample<Pose> sample_;
  std::vector<Pose> start_;
  std::optional<BatchResult<Pose>> told_apart_;  // from start_ at the scales that are tried, if that is known
  ByGroup<double> floor_{}, log_scale_{};
  ByGroup<Found> found_{};
  int steps_suspicious_ = 0;
  bool is_suspicious_ = false;  // some loops stand out: truncated least squares decides which ones count
  InformationEstimate out_;
};

}  // namespace

template <class Pose>
InformationEstimate EstimateInformationScale(const PoseGraph<Pose>& graph, const EstimateOptions& options) {
  if (graph.Poses().empty()) throw std::invalid_argument("the graph has no poses");
  if (options.draws < 2 || options.max_iterations < 1) {
    throw std::invalid_argument("an estimate of scales takes at least two draws and one iteration");
  }
  return Estimator<Pose>(graph, options).Run();
}

template InformationEstimate EstimateInformationScale<SE2>(const PoseGraph<SE2>&, const EstimateOptions&);
template InformationEstimate EstimateInformationScale<SE3>(const PoseGraph<SE3>&, const EstimateOptions&);

}  // namespace terse
