#include "pictures/plain_page.h"

#include "pictures/svg_chart.h"

namespace terse {
namespace {

constexpr const char* kPageHead = R"(<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<style>
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
table { border-collapse: collapse; }
th, td { text-align: right; padding: .2rem .8rem; border-bottom: 1px solid #8884; }
th:first-child { text-align: left; font-weight: normal; }
svg { max-width: 100%; height: auto; }
</style>
)";

}  // namespace

void WritePlainPage(const std::string& title, const std::string& body, const std::string& path) {
  WriteText(kPageHead + ("<title>" + EscapeXml(title)) + "</title></head><body>\n" + body + "\n<p>terse " +
                TERSE_VERSION + "</p>\n</body></html>\n",
            path);
}

}  // namespace terse
