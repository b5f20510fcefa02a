#pragma once
// The library's enumerations as strings, in the words of the command's options (terse/core/words.h).

#include <stdexcept>
#include <string>

#include "terse/compact/words.h"
#include "terse/core/evaluate.h"
#include "terse/core/trajectory.h"
#include "terse/covariance/convention.h"

namespace terse {

// Those that only Python names; the others are in the libraries' own tables.
TERSE_WORDS(Method, "method", {"levenberg_marquardt", Method::kLevenbergMarquardt},
            {"gauss_newton", Method::kGaussNewton});
TERSE_WORDS(Carry, "carry", {"offset", Carry::kOffset}, {"point", Carry::kPoint});
TERSE_WORDS(DecreaseScale, "decrease_scale", {"absolute", DecreaseScale::kAbsolute}, {"chi2", DecreaseScale::kChi2},
            {"dof", DecreaseScale::kDof});
TERSE_WORDS(CovarianceFrame, "frame", {"body", CovarianceFrame::kBody}, {"world", CovarianceFrame::kWorld},
            {"world_axes", CovarianceFrame::kWorldAxes});
TERSE_WORDS(TangentOrder, "order", {"translation_first", TangentOrder::kTranslationFirst},
            {"rotation_first", TangentOrder::kRotationFirst});
TERSE_WORDS(Freedom, "freedom", {"floating", Freedom::kFloating}, {"loosely_held", Freedom::kLooselyHeld},
            {"unmeasured", Freedom::kUnmeasured});
TERSE_WORDS(TrajectoryFormat, "format", {"tum", TrajectoryFormat::kTum}, {"kitti", TrajectoryFormat::kKitti},
            {"graph", TrajectoryFormat::kGraph});
TERSE_WORDS(Alignment, "alignment", {"se3", Alignment::kSE3}, {"se2", Alignment::kSE2}, {"none", Alignment::kNone});

}  // namespace terse

namespace terse::python {

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

}  // namespace terse::python
