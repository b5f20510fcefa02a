#pragma once
// All poses of a graph by gnc, its loops judged as those of a compact map are.

#include <functional>
#include <string>

#include "terse/core/batch_solver.h"

namespace terse {

// By information that is too cautious gnc believes groups of wrong loops, which are worth the odometry that they bend;
// the unit matrix contradicts next to nothing. So where `result`, of this graph by gnc, gives up many loops
// (AreLoopsInDoubt) and residuals contradict the information (CalibrateInformation), loops are judged by what residuals
// show (LoopJury). If `result` believes some that are contradicted then, the graph is solved again without these, by
// its information as it is stated: their weights are zero, chi2 counts them, robust_cost counts the width squared for
// each. That comes back if it costs less by what residuals show, `result` else. `options`: of the
// solves. `on_judging` is told why, before.
template <class Pose>
BatchResult<Pose> JudgedAgain(const PoseGraph<Pose>& graph, BatchResult<Pose> result, const BatchOptions& options,
                              const std::function<void(const std::string& why)>& on_judging = {});

}  // namespace terse
