#include "terse/core/generate_robots.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <stdexcept>

#include "experiments/generate_scene.h"
#include "experiments/wrong_loop_draw.h"
#include "terse/core/at.h"

namespace terse {
namespace {

using internal::At;
using internal::Below;
using internal::Random;
using internal::Rounded;

const SE2::Tangent kSigma(0.03, 0.03, 0.02);  // as of Scene::kManhattan
constexpr double kHalfPi = 1.5707963267948966;
// Wrong links of a group.
constexpr std::size_t kLeastOfGroup = 3, kMostOfGroup = 10;

struct Place {
  int robot;
  long pose;
};
using Cell = std::array<long, 2>;

class Robots {
 public:
  explicit Robots(const RobotsOptions& options) : options_(options), random_(options.seed), wrong_(~options.seed) {}

  RobotsData Run() {
    for (int r = 0; r < options_.robots; ++r) Drive(r);
    for (int r = 0; r < options_.robots; ++r) LinkTo(r);
    AddWrong();
    return std::move(data_);
  }

 private:
  const SE2& TrueAt(const Place& place) const {
    return data_.T_world_body_true[At(place.robot)][static_cast<std::size_t>(place.pose)];
  }
  static Cell CellOf(const SE2& T) { return {std::lround(T.Translation().x()), std::lround(T.Translation().y())}; }

  // Starts are on the grid of the blocks, which all robots share.
  void Drive(int robot) {
    const double reach = std::round(0.35 * std::sqrt(static_cast<double>(options_.poses)));
    const auto shift = [&] { return std::round((2 * random_.Uniform() - 1) * reach); };
    const double x = robot == 0 ? 0 : shift(), y = robot == 0 ? 0 : shift();
    const double turns = robot == 0 ? 0 : static_cast<double>(Below(random_, 4));
    const SE2 T_world_start(x, y, turns * kHalfPi);
    GenerateOptions scene;
    scene.scene = Scene::kManhattan;
    scene.poses = options_.poses;
    scene.seed = options_.seed * 1000003 + static_cast<std::uint64_t>(robot);
    PoseGraph<SE2> graph;
    std::vector<SE2> truth, composed;
    GenerateSink<SE2> sink;
    sink.pose = [&](PoseId id, const SE2& T_start_body) {
      truth.push_back(Rounded(T_world_start * T_start_body));
      composed.emplace_back();
      graph.AddPose(id, SE2());
    };
    sink.edge = [&](const RelativePoseFactor<SE2>& edge) {
      if (edge.to.value - edge.from.value == 1)
        composed[static_cast<std::size_t>(edge.to.value)] =
            Rounded(composed[static_cast<std::size_t>(edge.from.value)] * edge.T_from_to);
      graph.AddFactor(edge);
    };
    Generate(scene, sink);
    graph.SetPoses(composed);
    data_.graphs.push_back(std::move(graph));
    data_.T_world_body_true.push_back(std::move(truth));
  }

  RobotLink Measure(const Place& from, const Place& to, const SE2& T_from_to, bool is_wrong, Random& random) {
    SE2::Tangent noise;
    for (int d = 0; d < SE2::kDof; ++d) noise[d] = kSigma[d] * random.Normal();
    RobotLink link;
    link.from_robot = from.robot;
    link.to_robot = to.robot;
    link.measured.from = {from.pose};
    link.measured.to = {to.pose};
    link.measured.T_from_to = Rounded(T_from_to * SE2().Retract(noise).Inverse());
    for (int d = 0; d < SE2::kDof; ++d) link.measured.information(d, d) = Rounded(1 / (kSigma[d] * kSigma[d]));
    link.is_wrong = is_wrong;
    return link;
  }

  // To robots before it; then it is there for those that come.
  void LinkTo(int robot) {
    for (long k = 0; k < options_.poses && robot > 0; ++k) {
      if (random_.Uniform() >= options_.link_probability) continue;
      const Place to{robot, k};
      const Cell here = CellOf(TrueAt(to));
      std::vector<const std::vector<Place>*> near;
      std::size_t count = 0;
      for (const Cell step : {Cell{0, 0}, Cell{1, 0}, Cell{-1, 0}, Cell{0, 1}, Cell{0, -1}}) {
        const auto found = seen_.find({here[0] + step[0], here[1] + step[1]});
        if (found == seen_.end()) continue;
        near.push_back(&found->second);
        count += found->second.size();
      }
      if (count == 0) continue;
      std::size_t which = Below(random_, count);
      auto places = near.begin();
      for (; which >= (*places)->size(); ++places) which -= (*places)->size();
      const Place from = (**places)[which];
      data_.links.push_back(Measure(from, to, TrueAt(from).Inverse() * TrueAt(to), false, random_));
    }
    for (long k = 0; k < options_.poses; ++k) seen_[CellOf(TrueAt({robot, k}))].push_back({robot, k});
  }

  Place Anywhere(int robot) {
    return {robot, static_cast<long>(Below(wrong_, static_cast<std::size_t>(options_.poses)))};
  }

  void AddWrong() {
    const std::size_t true_links = data_.links.size();
    const auto count =
        static_cast<std::size_t>(std::lround(options_.wrong_link_percent / 100 * static_cast<double>(true_links)));
    std::vector<RobotLink> wrong;
    while (wrong.size() < count) {
      const int b = 1 + static_cast<int>(Below(wrong_, At(options_.robots - 1)));
      const int a = static_cast<int>(Below(wrong_, At(b)));
      const Place from = Anywhere(a), to = Anywhere(b);
      const RobotLink& like = data_.links[Below(wrong_, true_links)];
      const SE2 T_from_to = like.measured.T_from_to;
      const bool is_group = options_.wrong_link_kind == OutlierKind::kGrouped;
      const std::size_t size = is_group ? kLeastOfGroup + Below(wrong_, kMostOfGroup - kLeastOfGroup + 1) : 1;
      // One mistake about where the robots are: what follows agrees with it.
      const SE2 T_a_b = TrueAt(from) * T_from_to * TrueAt(to).Inverse();
      for (std::size_t s = 0; s < size && wrong.size() < count; ++s) {
        const Place i{a, from.pose + static_cast<long>(s)}, j{b, to.pose + static_cast<long>(s)};
        if (i.pose >= options_.poses || j.pose >= options_.poses) break;
        wrong.push_back(Measure(i, j, TrueAt(i).Inverse() * T_a_b * TrueAt(j), true, wrong_));
      }
    }
    data_.links.insert(data_.links.end(), wrong.begin(), wrong.end());
    std::stable_sort(data_.links.begin(), data_.links.end(), [](const RobotLink& x, const RobotLink& y) {
      return std::make_pair(x.to_robot, x.measured.to.value) < std::make_pair(y.to_robot, y.measured.to.value);
    });
  }

  const RobotsOptions& options_;
  Random random_, wrong_;
  RobotsData data_;
  std::map<Cell, std::vector<Place>> seen_;
};

}  // namespace

RobotsData GenerateRobots(const RobotsOptions& options) {
  if (options.robots < 2 || options.robots > 1000) throw std::invalid_argument("there must be 2 to 1000 robots");
  if (options.poses < 2) throw std::invalid_argument("a robot has two poses or more");
  if (!(options.link_probability >= 0 && options.link_probability <= 1))
    throw std::invalid_argument("the probability of a link must be between 0 and 1");
  if (!(options.wrong_link_percent >= 0 && options.wrong_link_percent <= 1e6))
    throw std::invalid_argument("the per cent of wrong links must be between 0 and 1e6");
  if (options.wrong_link_kind != OutlierKind::kRandom && options.wrong_link_kind != OutlierKind::kGrouped)
    throw std::invalid_argument("wrong links between robots are random or grouped");
  return Robots(options).Run();
}

}  // namespace terse
