#include "terse/compact/near_links.h"

#include <algorithm>
#include <utility>

#include "terse/core/at.h"

namespace terse::internal {
namespace {

// Keeps a pose with very many links from being looked through for each of them.
constexpr int kMostForEachPose = 16;

}  // namespace

auto NearLinks::Gather(int lists, const std::vector<std::pair<int, int>>& entries) -> Lists {
  Lists out;
  out.begin.assign(At(lists) + 1, 0);
  for (const auto& [list, item] : entries) ++out.begin[At(list) + 1];
  for (std::size_t k = 1; k < out.begin.size(); ++k) out.begin[k] += out.begin[k - 1];
  std::vector<int> at(out.begin);
  out.items.resize(entries.size());
  for (const auto& [list, item] : entries) out.items[At(at[At(list)]++)] = item;
  return out;
}

template <class Pose>
NearLinks::NearLinks(const LinkSystem<Pose>& system, const std::vector<char>& kept)
    : seen_pose_(At(system.poses), 0), seen_link_(system.links.size(), 0) {
  std::vector<std::pair<int, int>> joined, others;
  const auto join = [&](const auto& f) {
    joined.emplace_back(f.first, f.second);
    joined.emplace_back(f.second, f.first);
  };
  for (const auto& f : system.fixed) {
    if (f.second >= 0) join(f);
  }
  for (std::size_t k = 0; k < system.links.size(); ++k) {
    const auto& f = system.links[k];
    ends_.emplace_back(f.first, f.second);
    if (kept[k]) {
      join(f);
    } else {
      others.emplace_back(f.first, static_cast<int>(k));
      others.emplace_back(f.second, static_cast<int>(k));
    }
  }
  joined_ = Gather(system.poses, joined);
  others_ = Gather(system.poses, others);
}

const std::vector<int>& NearLinks::Of(int link, int reach) {
  ++calls_;
  near_.clear();
  queue_.clear();
  const auto visit = [&](int pose) {
    if (std::exchange(seen_pose_[At(pose)], calls_) != calls_) queue_.push_back(pose);
  };
  seen_link_[At(link)] = calls_;
  visit(ends_[At(link)].first);
  visit(ends_[At(link)].second);
  const std::size_t most_poses = At(reach), most_links = kMostForEachPose * most_poses;
  for (std::size_t k = 0; k < std::min(queue_.size(), most_poses); ++k) {
    const std::size_t pose = At(queue_[k]);
    for (int i = joined_.begin[pose]; i < joined_.begin[pose + 1] && queue_.size() < most_poses; ++i)
      visit(joined_.items[At(i)]);
    for (int i = others_.begin[pose]; i < others_.begin[pose + 1] && near_.size() < most_links; ++i) {
      const int other = others_.items[At(i)];
      if (std::exchange(seen_link_[At(other)], calls_) != calls_) near_.push_back(other);
    }
  }
  return near_;
}

template NearLinks::NearLinks(const LinkSystem<SE2>&, const std::vector<char>&);
template NearLinks::NearLinks(const LinkSystem<SE3>&, const std::vector<char>&);

}  // namespace terse::internal
