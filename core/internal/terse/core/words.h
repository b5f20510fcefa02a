#pragma once
// The words by which users name the values of an enumeration, in the options of the command, in Python and in files:
// all of these take them from here, in this order.

#include <utility>

#include "terse/core/arrival.h"
#include "terse/core/incremental_options.h"
#include "terse/core/initial_values.h"
#include "terse/core/outliers.h"
#include "terse/core/rotation_information.h"
#include "terse/core/step_report.h"

namespace terse {

// kWhat: what is named. kAll: pairs of a word and its value.
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
TERSE_WORDS(OutlierKind, "outlier_kind", {"random", OutlierKind::kRandom}, {"local", OutlierKind::kLocal},
            {"grouped", OutlierKind::kGrouped}, {"aliased", OutlierKind::kAliased});
TERSE_WORDS(ArrivalUnit, "every", {"pose", ArrivalUnit::kPose}, {"edge", ArrivalUnit::kEdge});
TERSE_WORDS(RobustKernel, "robust", {"none", RobustKernel::kNone}, {"huber", RobustKernel::kHuber},
            {"cauchy", RobustKernel::kCauchy}, {"tukey", RobustKernel::kTukey}, {"dcs", RobustKernel::kDcs},
            {"gnc", RobustKernel::kGnc});
TERSE_WORDS(Gate, "gate", {"newton_decrement", Gate::kNewtonDecrement},
            {"mutual_information", Gate::kMutualInformation}, {"log_determinant", Gate::kLogDeterminant},
            {"loop_closure", Gate::kLoopClosure}, {"always", Gate::kAlways}, {"never", Gate::kNever});
// The variants of Arablouei 2026 as they are called there.
TERSE_WORDS(Policy, "policy", {"default", Policy::kDefault}, {"gn1", Policy::kGn1}, {"gni", Policy::kGni},
            {"gni-lcg", Policy::kGniLcg}, {"gni-igg", Policy::kGniIgg}, {"gni-spo", Policy::kGniSpo},
            {"gni-spo-lcg", Policy::kGniSpoLcg}, {"gni-spo-igg", Policy::kGniSpoIgg});
TERSE_WORDS(CholeskyPath, "path", {"none", CholeskyPath::kNone}, {"appended", CholeskyPath::kAppended},
            {"rank_update", CholeskyPath::kRankUpdate}, {"refactored", CholeskyPath::kRefactored});

template <class E>
constexpr const char* WordOf(E value) {
  for (const auto& [word, named] : Words<E>::kAll) {
    if (named == value) return word;
  }
  return "?";
}

}  // namespace terse
