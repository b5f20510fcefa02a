#pragma once
// Links near a link: those that an end of it is close to along what is kept.

#include <vector>

#include "terse/compact/link_system.h"

namespace terse::internal {

class NearLinks {
 public:
  // `kept`: by link, of `system`.
  template <class Pose>
  NearLinks(const LinkSystem<Pose>& system, const std::vector<char>& kept);

  // The links that were not kept and have an end among the `reach` poses nearest to the link's ends, by edges. Not the
  // link itself, and not more than a few for each of these poses. Good until the next call.
  const std::vector<int>& Of(int link, int reach);

 private:
  // Lists one after the other: of i from begin[i] on.
  struct Lists {
    std::vector<int> begin, items;
  };
  static Lists Gather(int lists, const std::vector<std::pair<int, int>>& entries);

  std::vector<std::pair<int, int>> ends_;  // by link
  Lists joined_, others_;                  // by pose: poses; links not kept
  std::vector<int> seen_pose_, seen_link_, queue_, near_;
  int calls_ = 0;
};

}  // namespace terse::internal
