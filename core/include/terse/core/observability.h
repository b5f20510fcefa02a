#pragma once
// Why a linear system is singular: which motions of which poses no measurement sees.
//
// Three things leave motions free. A connected component of the graph may have no absolute measurement, so that it
// moves as a whole (the default anchor of gauge.h holds the component of the first pose only). Its absolute
// measurements may be too few, such as position priors on a line, about which it turns. Or factors inside the component
// say nothing about a direction. The first two are read off from the information J' Omega J that the absolute
// measurements have about the component's rigid motion, the last one from the null space of H: poses at which the
// factorisation fails are held, one after another, until it goes through; the null vectors are then the solutions that
// move what is held against nothing.
//
// A motion v inside a component is confirmed by |A v|^2, summed factor by factor, which sees far below the rounding of
// H. For use after a failure: about ten factorisations at most, and a path of the tree for every direction of a pose
// that is held. No more than eight poses are held, so there may be more such motions than are found; the others are
// complete.

#include <string>
#include <vector>

#include "terse/core/error.h"
#include "terse/core/linear_factor.h"
#include "terse/core/pose_graph.h"

namespace terse {

enum class Freedom {
  kFloating,     // a component without an absolute measurement: gauge not fixed
  kLooselyHeld,  // a component whose absolute measurements leave some of its rigid motions free
  kUnmeasured,   // inside a component: no factor measures it
};

struct FreeMotion {
  static constexpr std::size_t kIds = 5;
  Freedom freedom = Freedom::kFloating;
  std::size_t poses = 0;    // that it moves
  std::vector<PoseId> ids;  // the smallest of them, ascending, at most kIds
  // One of them, and its free directions as orthonormal columns: tangents [rho; phi], metres and radians, body frame.
  PoseId pose;
  MatrixX directions;
};

// In words: "translation x", "rotation about z", or the numbers where it is not along an axis.
std::string DescribeDirection(const VectorX& direction);
std::string Describe(const FreeMotion& motion);

// The system is singular, and these motions are free.
class UnobservableError : public NumericalError {
 public:
  UnobservableError(const std::string& message, std::vector<FreeMotion> motions)
      : NumericalError(message), motions_(std::move(motions)) {}
  const std::vector<FreeMotion>& motions() const { return motions_; }

 private:
  std::vector<FreeMotion> motions_;
};

struct SingularityReport {
  std::string message;
  std::vector<FreeMotion> motions;  // none if the system is not finite, or factors after all
  bool complete = true;             // false: there may be more
};

// Of a system whose factorisation failed at a variable: its linear factors, the anchor included, the values at which
// they were linearised and the poses' ids, by variable.
template <class Pose>
SingularityReport ExplainSingularity(std::vector<LinearFactor<Pose::kDof>> system,
                                     const std::vector<Pose>& T_world_body, const std::vector<PoseId>& ids,
                                     int failed_variable);

// UnobservableError, or NumericalError where no motion was found.
[[noreturn]] void ThrowSingular(SingularityReport report);

}  // namespace terse
