#include "bench_report.h"

#include <algorithm>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <thread>

namespace terse::bench {
namespace {

std::string OutputOf(const std::string& command) {
  FILE* pipe = popen(command.c_str(), "r");
  if (pipe == nullptr) return "";
  std::string out;
  for (int c; (c = std::fgetc(pipe)) != EOF;) out += static_cast<char>(c);
  pclose(pipe);
  while (!out.empty() && out.back() == '\n') out.pop_back();
  return out;
}

std::string ProcessorName() {
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);) {
    if (line.rfind("model name", 0) == 0) return line.substr(line.find(':') + 2);
  }
  return "unknown";
}

// The baselines stand and fall with it. Its file with the folder, which tells Debian's alternatives apart.
std::string BlasInUse() {
  std::ifstream maps("/proc/self/maps");
  std::string found = "unknown";
  for (std::string line; std::getline(maps, line);) {
    const std::size_t file = line.rfind('/');
    if (file == std::string::npos) continue;
    const std::string name = line.substr(file + 1);
    const auto begins = [&](const char* with) { return name.rfind(with, 0) == 0; };
    if (begins("libopenblas") || begins("libmkl")) return name;
    if (begins("libblas")) found = line.substr(line.rfind('/', file - 1) + 1);
  }
  return found;
}

std::string Short(double value) { return Format("%.3g", value); }
std::string Ratio(double value) { return value > 0 ? Format("%.1f", value) : "-"; }

// Cells padded so that the source is a table too.
class Table {
 public:
  explicit Table(std::vector<std::string> head) { rows_.push_back(std::move(head)); }
  void Add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  std::string Text() const {
    std::vector<std::size_t> width(rows_[0].size(), 4);
    for (const auto& row : rows_) {
      for (std::size_t c = 0; c < row.size(); ++c) width[c] = std::max(width[c], row[c].size());
    }
    std::string out;
    for (std::size_t r = 0; r < rows_.size(); ++r) {
      for (std::size_t c = 0; c < width.size(); ++c) {
        const std::string space(width[c] - rows_[r][c].size(), ' ');
        out += (c == 0 ? "| " + rows_[r][c] + space : " | " + space + rows_[r][c]);
      }
      out += " |\n";
      if (r > 0) continue;
      for (std::size_t c = 0; c < width.size(); ++c) {
        out += (c == 0 ? "| " : " | ") + std::string(width[c] - 1, '-') + (c == 0 ? '-' : ':');
      }
      out += " |\n";
    }
    return out;
  }

 private:
  std::vector<std::vector<std::string>> rows_;
};

std::string IncrementalTable(const nlohmann::json& graphs) {
  Table table({"graph", "poses", "factors", "total s", "median ms", "p99 ms", "worst ms", "mean gap", "final gap",
               "error mean, worst", "GFLOP", "GFLOP/s", "order, linearise, factor, solve, estimate, rest s",
               "CHOLMOD s", "ratio"});
  for (const auto& g : graphs) {
    if (!g.contains("incremental")) continue;
    const auto& i = g["incremental"];
    std::string phases;
    for (const char* name : {"order", "linearise", "factor", "solve", "estimate", "rest"}) {
      phases += (phases.empty() ? "" : ", ") + Format("%.2f", i["phases"][name]);
    }
    const double total = i["total_seconds"], cholmod = i["cholmod"]["total_seconds"];
    table.Add({g["name"], std::to_string(g["poses"].get<long>()), std::to_string(g["factors"].get<long>()),
               Short(total), Short(i["median_ms"]), Short(i["p99_ms"]), Short(i["worst_ms"]),
               Format("%.1e", i["mean_gap"]), Format("%.1e", i["final_gap"]),
               Format("%.3f", i["mean_error"]) + ", " + Format("%.3f", i["worst_error"]),
               Short(1e-9 * i["factor_flops"].get<double>()), Short(i["gflops_per_second"]), phases, Short(cholmod),
               Ratio(cholmod / total)});
  }
  return table.Text();
}

// What the phases reach of what the machine can do. Factoring counts flops; substitution reads every entry of L that it
// visits once, two flops for 8 bytes.
std::string RoofTable(const nlohmann::json& graphs, const nlohmann::json& roof) {
  const double peak = roof["gflops_per_second"], bandwidth = roof["gbytes_per_second"];
  Table table({"graph", "factoring GFLOP", "GFLOP/s", "of the product's", "substitution GFLOP", "GB read", "GB/s",
               "of memory's"});
  for (const auto& g : graphs) {
    if (!g.contains("incremental")) continue;
    const auto& i = g["incremental"];
    const double solve = 1e-9 * i["solve_flops"].get<double>(), read = 4 * solve;
    const double speed = i["gflops_per_second"], rate = read / i["phases"]["solve"].get<double>();
    table.Add({g["name"], Short(1e-9 * i["factor_flops"].get<double>()), Short(speed),
               Format("%.0f %%", 100 * speed / peak), Short(solve), Short(read), Short(rate),
               Format("%.0f %%", 100 * rate / bandwidth)});
  }
  return "Roof of one core (" + roof["kernels"].get<std::string>() + "): the dense product in cache " + Short(peak) +
         " GFLOP/s, memory " + Short(bandwidth) + " GB/s.\n\n" + table.Text();
}

std::string BatchTable(const nlohmann::json& graphs) {
  Table table({"graph", "start", "chi2", "terse ms", "iterations", "order, linearise, factor, solve ms", "Ceres ms",
               "iterations", "ratio"});
  for (const auto& g : graphs) {
    if (!g.contains("batch")) continue;
    const auto& b = g["batch"];
    const double terse = b["terse"]["seconds"], ceres = b["ceres"]["seconds"];
    std::string phases;
    for (const char* name : {"order", "linearise", "factor", "solve"}) {
      phases += (phases.empty() ? "" : ", ") + Format("%.0f", 1e3 * b["phases"][name].get<double>());
    }
    const auto ms = [](double seconds) { return seconds < 0 ? "never" : Short(1e3 * seconds); };
    table.Add({g["name"], b["start"], Format("%.8g", b["optimum"]), ms(terse),
               std::to_string(b["terse"]["iterations"].get<int>()), phases, ms(ceres),
               std::to_string(b["ceres"]["iterations"].get<int>()), Ratio(ceres / terse)});
  }
  return table.Text();
}

std::string GrowthTable(const nlohmann::json& runs) {
  Table table(
      {"poses", "links back", "factors", "up to step", "median ms", "p99 ms", "worst ms", "total s", "peak MB"});
  for (const auto& run : runs) {
    for (const auto& d : run["decades"]) {
      table.Add({std::to_string(run["poses"].get<long>()), run["longest_link"],
                 std::to_string(run["factors"].get<long>()), std::to_string(d["steps"].get<long>()),
                 Short(d["median_ms"]), Short(d["p99_ms"]), Short(d["worst_ms"]), Short(d["total_seconds"]),
                 Format("%.0f", d["peak_megabytes"])});
    }
  }
  return table.Text();
}

std::string Count(const nlohmann::json& value) { return std::to_string(value.get<long>()); }

std::string KeptTable(const nlohmann::json& graphs) {
  Table table({"graph", "poses", "solving s", "covariances s", "ratio", "all by recursion s", "faster by",
               "steps propagated, downdated, recursion (refreshed)", "drift", "measured", "error", "CHOLMOD's"});
  for (const auto& g : graphs) {
    if (!g.contains("covariance-kept")) continue;
    const auto& k = g["covariance-kept"];
    const double solving = k["solve_seconds"], seconds = k["seconds"], recursion = k["recursion_seconds"];
    std::string steps;
    for (const char* path : {"propagated", "downdated", "recursion"}) {
      steps += (steps.empty() ? "" : ", ") + std::to_string(k["steps"].value(path, 0));
    }
    table.Add({g["name"], Count(g["poses"]), Short(solving), Short(seconds), Format("%.2f", seconds / solving),
               Short(recursion), Ratio(recursion / seconds), steps + " (" + Count(k["refreshed"]) + ")",
               Format("%.0e", k["drift"]), Format("%.0e", k["measured_drift"]), Format("%.0e", k["error"]),
               Format("%.0e", k["cholmod_error"])});
  }
  return table.Text();
}

std::string NewestTable(const nlohmann::json& graphs) {
  Table table({"graph", "poses", "candidates", "solving s", "queries s", "share", "median ms", "worst ms"});
  for (const auto& g : graphs) {
    if (!g.contains("covariance-newest")) continue;
    const auto& n = g["covariance-newest"];
    const double solving = n["solve_seconds"], seconds = n["seconds"];
    table.Add({g["name"], Count(g["poses"]), Count(n["candidates"]), Short(solving), Short(seconds),
               Format("%.1f %%", 100 * seconds / solving), Short(n["median_ms"]), Short(n["worst_ms"])});
  }
  return table.Text();
}

std::string OptimumTable(const nlohmann::json& graphs) {
  Table table(
      {"graph", "poses", "factorisation ms", "covariances ms", "ratio", "Ceres s", "Ceres over ours", "difference"});
  for (const auto& g : graphs) {
    if (!g.contains("covariance-batch")) continue;
    const auto& b = g["covariance-batch"];
    const double factor = b["factor_seconds"], seconds = b["seconds"];
    std::vector<std::string> row = {g["name"], Count(g["poses"]), Short(1e3 * factor), Short(1e3 * seconds),
                                    Format("%.2f", seconds / factor)};
    if (b.contains("ceres")) {
      const double ceres = b["ceres"]["seconds"];
      row.insert(row.end(), {Short(ceres), Format("%.0f", ceres / seconds), Format("%.0e", b["ceres"]["difference"])});
    } else {
      row.insert(row.end(), {"none in " + Count(b["ceres_limit"]), "-", "-"});
    }
    table.Add(row);
  }
  return table.Text();
}

std::string JointTable(const nlohmann::json& runs) {
  Table table({"graph", "poses", "factors", "poses asked for", "median ms", "worst ms", "queries"});
  for (const auto& run : runs) {
    for (const auto& j : run["joint"]) {
      table.Add({run["name"], Count(run["poses"]), Count(run["factors"]), Count(j["size"]), Short(j["median_ms"]),
                 Short(j["worst_ms"]), Count(j["runs"])});
    }
  }
  return table.Text();
}

bool Any(const nlohmann::json& graphs, const char* what) {
  return std::any_of(graphs.begin(), graphs.end(), [&](const auto& g) { return g.contains(what); });
}

std::string MachineLine(const nlohmann::json& m) {
  return m["processor"].get<std::string>() + ", " + std::to_string(m["cores"].get<int>()) +
         " cores, one used; commit " + m["commit"].get<std::string>() + ", GCC " + m["compiler"].get<std::string>() +
         ", BLAS of the baselines " + m["blas"].get<std::string>() + ", " + m["date"].get<std::string>() + ".\n";
}

}  // namespace

std::string Format(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

nlohmann::json Machine() {
  char date[32];
  const std::time_t now = std::time(nullptr);
  std::strftime(date, sizeof date, "%Y-%m-%d", std::gmtime(&now));
  return {{"processor", ProcessorName()},
          {"cores", std::thread::hardware_concurrency()},
          {"commit", OutputOf("git -C '" TERSE_SOURCE_DIR "' describe --always --dirty --match= 2>/dev/null")},
          {"compiler", __VERSION__},
          {"blas", BlasInUse()},
          {"date", date}};
}

std::string Tables(const nlohmann::json& results) {
  const auto& graphs = results["graphs"];
  std::string out;
  if (Any(graphs, "incremental")) out += "\nIncremental:\n\n" + IncrementalTable(graphs);
  if (results.contains("roof")) out += "\n" + RoofTable(graphs, results["roof"]);
  if (Any(graphs, "batch")) out += "\nBatch:\n\n" + BatchTable(graphs);
  if (results.contains("growth")) out += "\nGrowth:\n\n" + GrowthTable(results["growth"]);
  return out.empty() ? out : MachineLine(results["machine"]) + out;
}

std::string CovarianceTables(const nlohmann::json& results) {
  const auto& graphs = results["graphs"];
  std::string out;
  if (Any(graphs, "covariance-kept")) out += "\nAll kept at every step:\n\n" + KeptTable(graphs);
  if (Any(graphs, "covariance-newest")) out += "\nNewest pose at every step:\n\n" + NewestTable(graphs);
  if (Any(graphs, "covariance-batch")) out += "\nAll at the optimum:\n\n" + OptimumTable(graphs);
  if (results.contains("covariance-joint")) out += "\nJoint:\n\n" + JointTable(results["covariance-joint"]);
  return out.empty() ? out : MachineLine(results["machine"]) + out;
}

std::string HistoryLine(const nlohmann::json& results) {
  if (!Any(results["graphs"], "incremental")) return "";
  const auto& m = results["machine"];
  std::string line = "| " + m["date"].get<std::string>() + " | " + m["commit"].get<std::string>() + " | " +
                     m["processor"].get<std::string>();
  if (results.contains("roof")) {
    line += " | " + Short(results["roof"]["gflops_per_second"]) + " | " + Short(results["roof"]["gbytes_per_second"]);
  } else {
    line += " | - | -";
  }
  for (const char* name : {"parking-garage", "sphere2500", "torus3D", "kitti00_all_loops", "intel", "manhattan",
                           "city10000", "w10000_hogman"}) {
    std::string seconds = "-";
    for (const auto& g : results["graphs"]) {
      if (g["name"] == name && g.contains("incremental")) seconds = Short(g["incremental"]["total_seconds"]);
    }
    line += " | " + seconds;
  }
  return line + " |\n";
}

}  // namespace terse::bench
