#pragma once
// examples/report/report.html as it was when this was built.

#include <string>

namespace terse {

std::string ReportPage();

}  // namespace terse
