#include "terse/core/pose_graph.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <locale>
#include <sstream>
#include <stdexcept>

#include "terse/core/decompositions.h"
#include "terse/core/definite.h"
#include "terse/core/pose_name.h"
#include "terse/core/residual.h"

namespace terse {

bool IsFinite(const SE2& T) { return T.Translation().allFinite() && std::isfinite(T.Theta()); }
bool IsFinite(const SE3& T) { return T.Translation().allFinite() && T.Rotation().Unit().coeffs().allFinite(); }

namespace {

template <int N>
bool IsFinite(const Vector<N>& p) {
  return p.allFinite();
}

template <class Measurement, int N>
std::string FindDefectIn(const std::string& name, const Measurement& measurement, const Matrix<N, N>& information) {
  if (!IsFinite(measurement)) return name + ": the measurement is not finite";
  if (!information.allFinite()) return name + ": the information is not finite";
  if (information.isZero(0)) {
    return name + ": the information is zero everywhere (unset?), expected a positive definite matrix";
  }
  if ((information - information.transpose()).cwiseAbs().maxCoeff() > 1e-12 * information.cwiseAbs().maxCoeff()) {
    return name + ": the information is not symmetric";
  }
  const Eigen::Matrix<double, N, N> aligned = information;
  if (!IsDefinite(aligned)) {
    std::ostringstream smallest;
    smallest.imbue(std::locale::classic());
    smallest << DecomposeSymmetric(aligned).values[0];
    return name + ": the information is not positive definite, its smallest eigenvalue is " + smallest.str();
  }
  return "";
}

}  // namespace

template <class Pose>
void PoseGraph<Pose>::AddPose(PoseId id, const std::optional<Pose>& T_world_body) {
  if (HasPose(id)) throw std::invalid_argument(Name(id) + " is in the graph already");
  if (T_world_body && !IsFinite(*T_world_body))
    throw std::invalid_argument(Name(id) + " has a value that is not finite");
  poses_.push_back({id, T_world_body, false});
  index_.emplace(id.value, static_cast<int>(poses_.size()) - 1);
}

template <class Pose>
void PoseGraph<Pose>::SetPose(PoseId id, const Pose& T_world_body) {
  const int index = IndexOf(id);
  if (!IsFinite(T_world_body)) throw std::invalid_argument(Name(id) + " would get a value that is not finite");
  poses_[static_cast<std::size_t>(index)].T_world_body = T_world_body;
}

template <class Pose>
void PoseGraph<Pose>::SetPoses(const std::vector<Pose>& T_world_body) {
  if (T_world_body.size() != poses_.size()) {
    throw std::invalid_argument(std::to_string(T_world_body.size()) + " values for " + std::to_string(poses_.size()) +
                                " poses");
  }
  for (std::size_t k = 0; k < poses_.size(); ++k) {
    if (!IsFinite(T_world_body[k])) {
      throw std::invalid_argument(Name(poses_[k].id) + " would get a value that is not finite");
    }
  }
  for (std::size_t k = 0; k < poses_.size(); ++k) poses_[k].T_world_body = T_world_body[k];
}

template <class Pose>
PoseGraph<Pose> PoseGraph<Pose>::WithPoses(const std::vector<Pose>& T_world_body) const {
  PoseGraph out = *this;
  out.SetPoses(T_world_body);
  return out;
}

template <class Pose>
void PoseGraph<Pose>::SetFixed(PoseId id, bool fixed) {
  poses_[static_cast<std::size_t>(IndexOf(id))].fixed = fixed;
}

template <class Pose>
FactorId PoseGraph<Pose>::AddFactor(const Factor<Pose>& factor) {
  return AddFactor(factor, NextFactorId());
}

template <class Pose>
FactorId PoseGraph<Pose>::AddFactor(const Factor<Pose>& factor, FactorId id) {
  if (id < NextFactorId()) throw std::invalid_argument("the id " + std::to_string(id.value) + " of a factor is taken");
  if (id.value == std::numeric_limits<std::int64_t>::max())
    throw std::invalid_argument("no id follows that of a factor");
  const FactorPoses ends = PosesOf(factor);
  IndexOf(ends.first);
  if (ends.count == 2) IndexOf(ends.second);
  const std::string defect = FindDefect(factor);
  if (!defect.empty()) throw std::invalid_argument(defect);
  factors_.Append(id, factor);
  next_factor_id_ = id.value + 1;
  return id;
}

template <class Pose>
bool PoseGraph<Pose>::RemoveFactor(FactorId id) {
  return factors_.Remove(id);
}

template <class Pose>
int PoseGraph<Pose>::IndexOf(PoseId id) const {
  const auto it = index_.find(id.value);
  if (it == index_.end()) throw std::invalid_argument(Name(id) + " is not in the graph");
  return it->second;
}

template <class Pose>
FactorPoses PosesOf(const Factor<Pose>& factor) {
  if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) return {f->from, f->to, 2};
  if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) return {f->pose, f->pose, 1};
  const PoseId id = std::get<PositionPriorFactor<Pose>>(factor).pose;
  return {id, id, 1};
}

template <class Pose>
std::string FindDefect(const Factor<Pose>& factor) {
  if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
    const std::string name = "edge " + std::to_string(f->from.value) + " -> " + std::to_string(f->to.value);
    if (f->from == f->to) return name + ": joins a pose to itself";
    return FindDefectIn(name, f->T_from_to, f->information);
  }
  if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) {
    return FindDefectIn("prior on " + Name(f->pose), f->T_world_body, f->information);
  }
  const auto& f = std::get<PositionPriorFactor<Pose>>(factor);
  if (!f.p_body.allFinite()) return "position prior on " + Name(f.pose) + ": the lever arm is not finite";
  return FindDefectIn("position prior on " + Name(f.pose), f.p_world, f.information);
}

template <class Pose>
double Chi2(const PoseGraph<Pose>& graph) {
  const auto value = [&](PoseId id) -> const Pose& {
    const auto& node = graph.Poses()[static_cast<std::size_t>(graph.IndexOf(id))];
    if (!node.T_world_body) throw std::invalid_argument(Name(id) + " has no value");
    return *node.T_world_body;
  };
  double chi2 = 0;
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    chi2 += FactorChi2(node.factor, value(ends.first), value(ends.second));
  }
  return chi2;
}

template <class Pose>
std::vector<std::vector<int>> ConnectedComponents(const PoseGraph<Pose>& graph) {
  std::vector<int> parent(graph.Poses().size());
  for (std::size_t i = 0; i < parent.size(); ++i) parent[i] = static_cast<int>(i);
  const auto root = [&](int i) {
    while (parent[static_cast<std::size_t>(i)] != i) {
      int& up = parent[static_cast<std::size_t>(i)];
      up = parent[static_cast<std::size_t>(up)];
      i = up;
    }
    return i;
  };
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const int a = root(graph.IndexOf(ends.first)), b = root(graph.IndexOf(ends.second));
    parent[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);
  }
  std::vector<std::vector<int>> components;
  std::vector<int> slot(parent.size(), -1);
  for (int i = 0; i < static_cast<int>(parent.size()); ++i) {
    int& s = slot[static_cast<std::size_t>(root(i))];
    if (s < 0) {
      s = static_cast<int>(components.size());
      components.emplace_back();
    }
    components[static_cast<std::size_t>(s)].push_back(i);
  }
  std::stable_sort(components.begin(), components.end(),
                   [](const auto& a, const auto& b) { return a.size() > b.size(); });
  return components;
}

#define TERSE_INSTANTIATE(Pose)                               \
  template class PoseGraph<Pose>;                             \
  template FactorPoses PosesOf<Pose>(const Factor<Pose>&);    \
  template std::string FindDefect<Pose>(const Factor<Pose>&); \
  template double Chi2<Pose>(const PoseGraph<Pose>&);         \
  template std::vector<std::vector<int>> ConnectedComponents<Pose>(const PoseGraph<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
