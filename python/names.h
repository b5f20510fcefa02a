#pragma once
// The library's enumerations as strings, the words of the command's options.

#include <stdexcept>
#include <string>
#include <utility>

#include "terse/compact/compact_pose_slam.h"
#include "terse/core/arrival.h"
#include "terse/core/evaluate.h"
#include "terse/core/initial_values.h"
#include "terse/core/rotation_information.h"
#include "terse/core/trajectory.h"
#include "terse/covariance/convention.h"

namespace terse::python {

template <class E>
struct Words;

#define TERSE_WORDS(E, WHAT, ...)                                      \
  template <>                                                          \
  struct Words<E> {                                                    \
    static constexpr const char* kWhat = WHAT;                         \
    static constexpr std::pair<const char*, E> kAll[] = {__VA_ARGS__}; \
  }

TERSE_WORDS(RotationInformation, "rotation_information", {"quaternion", RotationInformation::kQuaternion},
            {"radians", RotationInformation::kRadians});
TERSE_WORDS(InitialValues, "initial", {"auto", InitialValues::kAuto}, {"compose", InitialValues::kCompose},
            {"file", InitialValues::kFile}, {"tree", InitialValues::kTree}, {"chordal", InitialValues::kChordal});
TERSE_WORDS(Method, "method", {"levenberg_marquardt", Method::kLevenbergMarquardt},
            {"gauss_newton", Method::kGaussNewton});
TERSE_WORDS(RobustKernel, "robust", {"none", RobustKernel::kNone}, {"huber", RobustKernel::kHuber},
            {"cauchy", RobustKernel::kCauchy}, {"tukey", RobustKernel::kTukey}, {"dcs", RobustKernel::kDcs},
            {"gnc", RobustKernel::kGnc});
TERSE_WORDS(Carry, "carry", {"offset", Carry::kOffset}, {"point", Carry::kPoint});
TERSE_WORDS(Gate, "gate", {"newton_decrement", Gate::kNewtonDecrement},
            {"mutual_information", Gate::kMutualInformation}, {"log_determinant", Gate::kLogDeterminant},
            {"loop_closure", Gate::kLoopClosure}, {"always", Gate::kAlways}, {"never", Gate::kNever});
TERSE_WORDS(DecreaseScale, "decrease_scale", {"absolute", DecreaseScale::kAbsolute}, {"chi2", DecreaseScale::kChi2},
            {"dof", DecreaseScale::kDof});
TERSE_WORDS(Policy, "policy", {"default", Policy::kDefault}, {"gn1", Policy::kGn1}, {"gni", Policy::kGni},
            {"gni-lcg", Policy::kGniLcg}, {"gni-igg", Policy::kGniIgg}, {"gni-spo", Policy::kGniSpo},
            {"gni-spo-lcg", Policy::kGniSpoLcg}, {"gni-spo-igg", Policy::kGniSpoIgg});
TERSE_WORDS(CholeskyPath, "path", {"none", CholeskyPath::kNone}, {"appended", CholeskyPath::kAppended},
            {"rank_update", CholeskyPath::kRankUpdate}, {"refactored", CholeskyPath::kRefactored});
TERSE_WORDS(ArrivalUnit, "every", {"pose", ArrivalUnit::kPose}, {"edge", ArrivalUnit::kEdge});
TERSE_WORDS(CovarianceFrame, "frame", {"body", CovarianceFrame::kBody}, {"world", CovarianceFrame::kWorld},
            {"world_axes", CovarianceFrame::kWorldAxes});
TERSE_WORDS(TangentOrder, "order", {"translation_first", TangentOrder::kTranslationFirst},
            {"rotation_first", TangentOrder::kRotationFirst});
TERSE_WORDS(Freedom, "freedom", {"floating", Freedom::kFloating}, {"loosely_held", Freedom::kLooselyHeld},
            {"unmeasured", Freedom::kUnmeasured});
TERSE_WORDS(TrajectoryFormat, "format", {"tum", TrajectoryFormat::kTum}, {"kitti", TrajectoryFormat::kKitti},
            {"graph", TrajectoryFormat::kGraph});
TERSE_WORDS(Alignment, "alignment", {"se3", Alignment::kSE3}, {"se2", Alignment::kSE2}, {"none", Alignment::kNone});
TERSE_WORDS(Strategy, "strategy", {"apal", Strategy::kApal}, {"apfl", Strategy::kApfl}, {"fpfl", Strategy::kFpfl},
            {"rfpfl", Strategy::kGiven});
TERSE_WORDS(AngleMeasure, "angle", {"view", AngleMeasure::kViewDirection}, {"rotation", AngleMeasure::kRotation});
TERSE_WORDS(CompositionOrder, "composition", {"first", CompositionOrder::kFirst},
            {"fourth", CompositionOrder::kFourth});
TERSE_WORDS(Record, "record", {"none", Record::kNone}, {"decisions", Record::kDecisions},
            {"candidates", Record::kCandidates});
TERSE_WORDS(Recovery, "recovery", {"v0", Recovery::kV0}, {"v1", Recovery::kV1}, {"v2", Recovery::kV2});

#undef TERSE_WORDS

// Throws std::invalid_argument with the words that there are.
template <class E>
E FromWord(const std::string& word) {
  std::string all;
  for (const auto& [name, value] : Words<E>::kAll) {
    if (word == name) return value;
    all += (all.empty() ? "" : ", ") + std::string(name);
  }
  throw std::invalid_argument(std::string(Words<E>::kWhat) + ": expected one of " + all + ", got '" + word + "'");
}

template <class E>
const char* WordOf(E value) {
  for (const auto& [name, other] : Words<E>::kAll) {
    if (other == value) return name;
  }
  return "?";
}

}  // namespace terse::python
