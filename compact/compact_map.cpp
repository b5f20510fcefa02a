#include "terse/compact/compact_map.h"

#include <cmath>
#include <set>
#include <string>
#include <type_traits>
#include <unordered_map>

#include "terse/core/definite.h"
#include "terse/core/pose_name.h"

namespace terse {
namespace {

using std::size_t;

template <class Pose>
bool IsCovariance(const UncertainPose<Pose>& pose) {
  const auto& S = pose.covariance;
  return S.allFinite() && (S - S.transpose()).norm() <= 1e-9 * S.norm() && (S.diagonal().array() >= 0).all();
}

// Looks a map through, in the order of its members.
template <class Pose>
class Inspection {
 public:
  explicit Inspection(const CompactMap<Pose>& map) : map_(map) {}

  std::string Run() {
    if (map_.forgotten < 0 || map_.forgotten > 1000000000) return "forgotten: expected 0 to 1e9";
    if (map_.forgotten > 0 && map_.poses.empty()) return "forgotten: there are no poses";
    CheckPoses();
    CheckEdges();
    CheckPriors();
    CheckFixed();
    CheckTried("refused", map_.refused);
    CheckTried("failed", map_.failed);
    return defect_;
  }

 private:
  using SeenPose = typename CompactMap<Pose>::SeenPose;

  void Fail(const std::string& key, const std::string& cause) {
    if (defect_.empty()) defect_ = where_ + key + ": " + cause;
  }
  // Calls check(element) for each while there is no defect.
  template <class Element, class Check>
  void Each(const char* list, const std::vector<Element>& elements, const Check& check) {
    for (size_t k = 0; k < elements.size() && defect_.empty(); ++k) {
      where_ = std::string(list) + "[" + std::to_string(k) + "].";
      check(elements[k]);
    }
  }
  void CheckPoses() {
    Each("poses", map_.poses, [&](const SeenPose& pose) {
      CheckPose(pose);
      at_.emplace(pose.id.value, at_.size());
    });
    Each("poses", map_.poses, [&](const SeenPose& pose) { CheckNext(pose); });
  }
  void CheckEdges() {
    Each("edges", map_.edges, [&](const auto& edge) {
      const std::string where = where_;
      CheckFactor(edge.factor);
      ExpectKept(edge.measured.from, "from");
      ExpectKept(edge.measured.to, "to");
      ExpectCame(edge.added_at, "added_at");
      CheckMeasured(Factor<Pose>(edge.measured));
      CheckParts(edge.parts, where);
    });
  }
  void CheckPriors() {
    Each("priors", map_.priors, [&](const auto& prior) {
      CheckFactor(prior.factor);
      const FactorPoses ends = PosesOf(prior.measured);
      if (ends.count != 1) Fail("measurement", "a link, expected a prior");
      ExpectKept(ends.first, "pose");
      CheckMeasured(prior.measured);
    });
  }
  void CheckFixed() {
    std::set<PoseId> seen;
    Each("fixed", map_.fixed, [&](const auto& fixed) {
      ExpectKept(fixed.pose, "pose");
      if (!seen.insert(fixed.pose).second) Fail("pose", Name(fixed.pose) + " is there twice");
      if (!IsFinite(fixed.T_world_body)) Fail("T_world_body", "not finite");
    });
  }
  // Links that were not to be.
  template <class Tried>
  void CheckTried(const char* list, const std::vector<Tried>& links) {
    Each(list, links, [&](const Tried& link) {
      ExpectKept(link.candidate, "candidate");
      ExpectSeen(link.seen, "seen");
      if constexpr (std::is_same_v<Tried, typename CompactMap<Pose>::Refused>) {
        CheckChain(link.T_candidate_seen, "T_candidate_seen", "covariance");
      }
    });
  }
  const SeenPose* Earlier(PoseId id) const {
    const auto it = at_.find(id.value);
    return it == at_.end() ? nullptr : &map_.poses[it->second];
  }
  void CheckChain(const UncertainPose<Pose>& chain, const char* key, const char* covariance) {
    if (!IsFinite(chain.T_a_b)) Fail(key, "not finite");
    if (!IsCovariance(chain)) Fail(covariance, "no covariance: expected finite, symmetric, variances not negative");
  }
  // Where some are forgotten, so may those be that odometry comes from, but not the poses that chains lead through.
  void CheckPrevious(const SeenPose& pose, bool is_first) {
    if (is_first && pose.previous) Fail("previous", "the first pose has none");
    if (is_first && pose.anchored_to) Fail("anchored_to", "the first pose hangs on no other");
    const bool may_be_forgotten = map_.forgotten > 0 && pose.anchored_to;
    if (!is_first && !pose.previous && !may_be_forgotten) Fail("previous", "missing, expected an id");
    if (!is_first && map_.forgotten > 0 && !(newest_ < pose.id))
      Fail("id", Name(pose.id) + " comes after " + Name(newest_) + ", but where poses are forgotten ids ascend");
    newest_ = pose.id;
  }
  void CheckPose(const SeenPose& pose) {
    if (at_.count(pose.id.value) != 0) Fail("id", Name(pose.id) + " is there twice");
    if (!IsFinite(pose.T_world_body)) Fail("T_world_body", "not finite");
    if (!IsFinite(pose.T_world_body_when_seen)) Fail("T_world_body_when_seen", "not finite");
    const bool is_first = at_.empty();
    if (is_first && !pose.kept) Fail("kept", "false, but the first pose is always kept");
    CheckPrevious(pose, is_first);
    const SeenPose* previous = pose.previous ? Earlier(*pose.previous) : nullptr;
    if (pose.previous && previous == nullptr) {
      Fail("previous", Name(*pose.previous) + " is none of the poses before");
      return;
    }
    const SeenPose* parent = pose.anchored_to ? Earlier(*pose.anchored_to) : previous;
    if (pose.anchored_to && parent == nullptr) {
      Fail("anchored_to", Name(*pose.anchored_to) + " is none of the poses before");
      return;
    }
    const PoseId base = pose.kept || parent == nullptr ? pose.id : parent->base;
    if (pose.base != base) Fail("base", Name(pose.base) + ", expected " + Name(base));
    if (!pose.kept) CheckChain(pose.T_base_pose, "T_base_pose", "covariance");
  }
  void CheckNext(const SeenPose& pose) {
    if (pose.kept || !pose.next_kept) {
      if (pose.ended_by) Fail("ended_by", "the chain of the pose has not ended at a kept pose");
      return;
    }
    ExpectKept(*pose.next_kept, "next_kept");
    CheckChain(pose.T_base_next, "T_base_next", "covariance_next");
    if (!pose.ended_by) return;
    const SeenPose* end = Earlier(*pose.ended_by);
    if (end != nullptr && at_.at(end->id.value) <= at_.at(pose.id.value)) {
      Fail("ended_by", Name(*pose.ended_by) + " does not come after the pose");
    } else if (end == nullptr || !end->anchored_to || !end->previous) {
      Fail("ended_by", Name(*pose.ended_by) + (end == nullptr ? " is none of the poses" : " was not anchored"));
    }
  }
  void ExpectKept(PoseId id, const char* key) {
    const SeenPose* pose = Earlier(id);
    if (pose == nullptr || !pose->kept) {
      Fail(key, Name(id) + (pose == nullptr ? " is none of the poses" : " was dropped, expected a kept one"));
    }
  }
  void ExpectSeen(PoseId id, const char* key) {
    if (at_.count(id.value) == 0) Fail(key, Name(id) + " is none of the poses");
  }
  // Forgotten or not.
  void ExpectCame(PoseId id, const char* key) {
    const auto& poses = map_.poses;
    const bool is_forgotten = map_.forgotten > 0 && !poses.empty() && poses.front().id < id && id < poses.back().id;
    if (at_.count(id.value) == 0 && !is_forgotten) Fail(key, Name(id) + " is none of the poses");
  }
  void CheckParts(const std::vector<typename CompactMap<Pose>::Part>& parts, const std::string& edge) {
    for (size_t k = 0; k < parts.size() && defect_.empty(); ++k) {
      where_ = edge + "parts[" + std::to_string(k) + "].";
      ExpectCame(parts[k].added_at, "added_at");
      const std::int64_t id = parts[k].id.value, limit = std::int64_t{1} << 60;
      if (id < -limit || (id < -1 && !parts_.insert(parts[k].id).second))
        Fail("id", std::to_string(id) + (id < -limit ? " is out of range" : " is there twice"));
      if (parts[k].measurements < 1 || parts[k].measurements > limit) Fail("measurements", "expected 1 or more");
      if (!std::isfinite(parts[k].gain)) Fail("gain_nats", "not finite");
      CheckChain(parts[k].T_from_to, "T_from_to", "covariance");
      const bool is_definite = IsDefinite<Pose::kDof>(parts[k].T_from_to.covariance);
      if (!is_definite) Fail("covariance", "not positive definite");
    }
  }
  void CheckFactor(FactorId id) {
    if (id.value < 0) Fail("factor", std::to_string(id.value) + ", expected 0 or more");
    if (!factors_.insert(id).second) Fail("factor", std::to_string(id.value) + " is there twice");
  }
  void CheckMeasured(const Factor<Pose>& measured) {
    const std::string defect = FindDefect(measured);
    if (!defect.empty()) Fail("measurement", defect);
  }

  const CompactMap<Pose>& map_;
  std::string where_, defect_;
  PoseId newest_;                                // looked through
  std::unordered_map<std::int64_t, size_t> at_;  // of those looked through
  std::set<FactorId> factors_, parts_;
};

}  // namespace

template <class Pose>
std::string FindDefect(const CompactMap<Pose>& map) {
  return Inspection<Pose>(map).Run();
}

template std::string FindDefect(const CompactMap<SE2>&);
template std::string FindDefect(const CompactMap<SE3>&);

}  // namespace terse
