#include "pictures/merge_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <sstream>
#include <unordered_map>

#include "pictures/map_picture.h"
#include "pictures/plain_page.h"
#include "pictures/svg_chart.h"
#include "terse/core/stamped_trajectory.h"

namespace terse {
namespace {

using Json = nlohmann::ordered_json;

// Kept poses and edges; `is_link` says which edges are drawn as links.
template <class Pose, class IsLink>
RunFolder Picture(const std::string& name, const CompactMap<Pose>& map, const IsLink& is_link) {
  RunFolder run;
  run.name = name;
  run.dimension = Pose::kDim;
  std::unordered_map<std::int64_t, int> place;
  for (const auto& pose : map.poses) {
    place.emplace(pose.id.value, static_cast<int>(run.ids.size()));
    run.ids.push_back(pose.id.value);
    run.kept.push_back(pose.kept ? 1 : 0);
    run.T_world_body.push_back(InSpace(pose.T_world_body));
  }
  for (const auto& edge : map.edges) {
    const int from = place.at(edge.measured.from.value), to = place.at(edge.measured.to.value);
    if (is_link(edge)) {
      RunLink link;
      link.from = from;
      link.to = to;
      link.step = std::max(from, to);
      run.links.push_back(link);
    } else {
      run.chain.push_back({from, to, 0});
    }
  }
  return run;
}

std::string Number(double value) {
  if (std::abs(value) < 1e-12) value = 0;  // rounding
  char text[40];
  std::snprintf(text, sizeof text, "%.4g", value);
  return text;
}

std::string List(const Json& numbers) {
  std::string out;
  for (const Json& number : numbers) out += (out.empty() ? "" : ", ") + Number(number.get<double>());
  return out;
}

std::string Row(const char* tag, const std::vector<std::string>& cells) {
  std::string out = "<tr>";
  for (const std::string& cell : cells) out += std::string("<") + tag + ">" + cell + "</" + tag + ">";
  return out + "</tr>\n";
}

}  // namespace

template <class Pose>
void WriteMergeReport(const std::vector<MapToMerge<Pose>>& maps, const Merged<Pose>& merged, const Json& stats,
                      const std::string& path) {
  std::ostringstream out;
  out << "<h1>" << maps.size() << " maps, merged</h1>\n<table>"
      << Row("th", {"map", "held by", "poses", "kept", "links", "accepted", "ids moved by",
                    Pose::kDim == 2 ? "origin in the joint map (m, rad)" : "origin in the joint map (m, quaternion)",
                    "sigma of its first pose"});
  for (const Json& map : stats["maps"]) {
    const bool is_apart = !map.contains("T_joint_map");
    out << Row("td",
               {EscapeXml(map["name"].get<std::string>()), map["placement"].get<std::string>(), map["poses"].dump(),
                map["poses_kept"].dump(), map["links"].dump(), map["links_accepted"].dump(), map["id_offset"].dump(),
                is_apart ? "" : List(map["T_joint_map"]), is_apart ? "" : List(map["sigma_of_first_pose"])});
  }
  out << "</table>\n<p>" << stats["links_accepted"] << " of " << stats["links"] << " links between maps are in, "
      << stats["links_inconsistent"] << " contradict the others; " << stats["poses_kept"] << " poses are kept, "
      << stats["retired"] << " retired.</p>\n<h2>The joint map, and each map alone</h2>\n";
  std::unordered_map<std::int64_t, std::size_t> map_of;  // by joint id
  for (std::size_t k = 0; k < maps.size(); ++k) {
    for (const auto& pose : maps[k].map.poses) map_of[pose.id.value + merged.maps[k].id_offset] = k;
  }
  RunFolder joint = Picture("joint map, links between maps", merged.map, [&](const auto& edge) {
    return map_of.at(edge.measured.from.value) != map_of.at(edge.measured.to.value);
  });
  for (std::size_t k = 1; k < joint.ids.size(); ++k) {
    if (map_of.at(joint.ids[k]) != map_of.at(joint.ids[k - 1])) joint.starts.push_back(k);
  }
  out << DrawMaps({joint});
  for (const auto& map : maps) {
    out << '\n' << DrawMaps({Picture(map.name, map.map, [](const auto& edge) { return edge.is_loop; })});
  }
  WritePlainPage("merged map", out.str(), path);
}

template void WriteMergeReport(const std::vector<MapToMerge<SE2>>&, const Merged<SE2>&, const Json&,
                               const std::string&);
template void WriteMergeReport(const std::vector<MapToMerge<SE3>>&, const Merged<SE3>&, const Json&,
                               const std::string&);

}  // namespace terse
