#include "pictures/sparsify_report.h"

#include <algorithm>
#include <cstdio>
#include <map>
#include <sstream>

#include "pictures/map_picture.h"
#include "pictures/plain_page.h"
#include "pictures/svg_chart.h"
#include "terse/compact/words.h"
#include "terse/core/stamped_trajectory.h"

namespace terse {
namespace {

using Json = nlohmann::ordered_json;

template <class Pose>
RunFolder Picture(const std::string& name, const PoseGraph<Pose>& all, const std::vector<Pose>& T_world_body) {
  RunFolder run;
  run.name = name;
  run.dimension = Pose::kDim;
  for (std::size_t v = 0; v < all.Poses().size(); ++v) {
    run.ids.push_back(all.Poses()[v].id.value);
    run.kept.push_back(1);
    run.T_world_body.push_back(InSpace(T_world_body[v]));
  }
  return run;
}

// The whole graph and what was kept of it, links coloured by what they are worth.
template <class Pose>
std::string DrawBoth(const PoseGraph<Pose>& graph, const Sparsified<Pose>& small, const std::string& unit) {
  RunFolder before = Picture("before", graph, small.T_world_body_whole);
  RunFolder after = Picture("after", graph, small.T_world_body);
  const auto link_of = [&](PoseId from, PoseId to, double worth) {
    RunLink link;
    link.from = graph.IndexOf(from);
    link.to = graph.IndexOf(to);
    link.step = std::max(link.from, link.to);
    if (worth > 0) link.gain = worth;
    return link;
  };
  for (const ConsideredLink& link : small.links) before.links.push_back(link_of(link.from, link.to, link.worth));
  for (std::size_t v = 0; v < graph.Poses().size(); ++v)
    after.kept[v] = static_cast<char>(small.graph.HasPose(graph.Poses()[v].id));
  std::map<FactorId, double> worth;
  for (const ConsideredLink& link : small.links) worth[link.id] = link.worth;
  for (const auto& edge : small.map.edges) {
    const auto known = worth.find(edge.factor);
    if (edge.is_loop) {
      after.links.push_back(link_of(edge.measured.from, edge.measured.to, known != worth.end() ? known->second : 0));
    } else {
      after.chain.push_back({graph.IndexOf(edge.measured.from), graph.IndexOf(edge.measured.to), 0});
    }
  }
  return DrawMaps({before, after}, unit);
}

ChartLine Ranked(const std::string& name, std::vector<double> values) {
  std::sort(values.begin(), values.end(), std::greater<>());
  ChartLine line;
  line.name = name;
  for (std::size_t k = 0; k < values.size(); ++k) {
    line.x.push_back(static_cast<double>(k + 1));
    line.y.push_back(values[k]);
  }
  return line;
}

template <class Pose>
std::string DrawLinks(const Sparsified<Pose>& small, const std::string& unit) {
  std::vector<ChartPanel> panels;
  std::vector<double> kept, left;
  for (const ConsideredLink& link : small.links) (link.kept ? kept : left).push_back(link.worth);
  const bool has_worth = std::any_of(small.links.begin(), small.links.end(), [](const auto& l) { return l.worth > 0; });
  if (has_worth) {
    ChartPanel panel{"Links by worth", "rank", "worth (" + unit + ")", {Ranked("kept, at their choice", kept)}};
    panel.lines.push_back(Ranked("left out, beside those kept", left));
    panel.log_y = panel.log_x = true;
    panels.push_back(panel);
  }
  if (small.course.size() > 1) {
    ChartPanel panel{"Error against size", "links kept", "expected position error (m)", {}};
    ChartLine line, whole;
    line.name = "expected error of the sparsified graph";
    line.marked = true;
    whole.name = "of the whole graph";
    whole.dashed = true;
    for (const SparsifyPoint& point : small.course) {
      line.x.push_back(std::max(1, point.links));
      line.y.push_back(point.expected_error);
    }
    whole.x = {line.x.front(), line.x.back()};
    whole.y = {small.expected_error_whole, small.expected_error_whole};
    panel.lines = {line, whole};
    panel.log_y = panel.log_x = true;
    panels.push_back(panel);
  }
  if (small.loss > 0) {
    ChartPanel panel{"Loss of the dropped poses", "poses dropped", "lost so far (nats)", {}};
    ChartLine line;
    line.name = "divergence from the exact marginal, summed";
    double sum = 0;
    for (std::size_t k = 0; k < small.dropped.size(); ++k) {
      line.x.push_back(static_cast<double>(k + 1));
      line.y.push_back(sum += small.dropped[k].loss);
    }
    panel.lines = {line};
    panels.push_back(panel);
  }
  return panels.empty() ? "" : DrawCharts("Links, error and loss", panels);
}

std::string Number(const Json& value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.4g", value.get<double>());
  return text;
}

std::string Rows(const Json& stats) {
  std::ostringstream out;
  const auto row = [&](const std::string& what, const std::string& before, const std::string& after) {
    out << "<tr><th>" << what << "</th><td>" << before << "</td><td>" << after << "</td></tr>\n";
  };
  row("poses", stats["poses"].dump(), stats["poses_kept"].dump());
  row("links", stats["links"].dump(), stats["links_kept"].dump());
  row("factors in all", stats["factors"].dump(), stats["factors_kept"].dump());
  row("expected position error, m", Number(stats["expected_error_whole_m"]), Number(stats["expected_error_m"]));
  row("log-determinant lost by links, nats", "", Number(stats["log_det_lost_nats"]));
  row("divergence by dropped poses, nats", "", Number(stats["divergence_nats"]));
  row("chi2 at the optimum", Number(stats["chi2_whole"]), Number(stats["chi2"]));
  return out.str();
}

}  // namespace

template <class Pose>
void WriteSparsifyReport(const std::string& name, const PoseGraph<Pose>& graph, const Sparsified<Pose>& small,
                         const Json& stats, const std::string& path) {
  const std::string unit = stats["criterion"] == WordOf(SparsifyCriterion::kPosition) ? "m²" : "nats";
  std::ostringstream out;
  out << "<h1>" << EscapeXml(name) << ", sparsified by " << EscapeXml(stats["criterion"].get<std::string>())
      << "</h1>\n"
      << "<table><tr><th></th><th>before</th><th>after</th></tr>\n"
      << Rows(stats) << "</table>\n<h2>The map before and after</h2>\n"
      << DrawBoth(graph, small, unit) << "\n"
      << DrawLinks(small, unit);
  WritePlainPage(name + ", sparsified", out.str(), path);
}

template void WriteSparsifyReport(const std::string&, const PoseGraph<SE2>&, const Sparsified<SE2>&, const Json&,
                                  const std::string&);
template void WriteSparsifyReport(const std::string&, const PoseGraph<SE3>&, const Sparsified<SE3>&, const Json&,
                                  const std::string&);

}  // namespace terse
