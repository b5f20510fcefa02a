#pragma once
// A run of `online`: lines in, answers out, a journal beside it.

#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "run/journal.h"
#include "run/line_source.h"
#include "terse/compact/measurement_stream.h"
#include "terse/core/graph_file.h"
#include "terse/covariance/convention.h"

namespace terse {

struct OnlineRunOptions {
  std::string directory;                  // for outputs at the end; none if empty
  long journal_bytes = 64 * 1000 * 1000;  // beyond which the journal begins anew
  int agreeing_links = 5;                 // that make a received map part of the run's
  Recovery recovery = Recovery::kV2;
  ReadOptions read;
  CovarianceConvention convention;
  bool covariances = false, strict = false, quiet = false;
  std::optional<ReviewOptions> review = ReviewOptions();  // MeasurementStream::StartReviews
};

// The options of the run that the journal was begun with. Throws FileError.
nlohmann::ordered_json ParseHeader(const Journal& journal);

// To the end of the input. `header`: what the lines' meaning depends on; a journal that was begun with another one is
// refused. Without a journal: nullptr. Throws FileError.
template <class Pose>
void RunOnline(const CompactOptions<Pose>& settings, const OnlineRunOptions& options,
               const nlohmann::ordered_json& header, Journal* journal, LineSource& source);

}  // namespace terse
