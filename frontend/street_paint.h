#pragma once
// What the surfaces of the street look like. Everything follows from the seed; no two surfaces look the same.

#include <cstdint>

#include "street_path.h"
#include "street_texture.h"

namespace terse {

// Metres left of the driving line to the middle of the road, and from there to either side.
constexpr double kRoadMiddle = 1.6, kLaneEdge = 3.2, kCurb = 5.2, kSidewalkEdge = 7.6;

void PaintFacade(StreetCanvas& canvas, std::uint64_t seed);
void PaintBlankWall(StreetCanvas& canvas, std::uint64_t seed);
void PaintCar(StreetCanvas& canvas, std::uint64_t seed);
void PaintCarWindows(StreetCanvas& canvas, std::uint64_t seed);
void PaintLeaves(StreetCanvas& canvas, std::uint64_t seed);
void PaintPost(StreetCanvas& canvas, std::uint64_t seed);
void PaintSign(StreetCanvas& canvas, std::uint64_t seed);
void PaintSky(StreetCanvas& canvas, std::uint64_t seed);
// The ground from (x0, y0) on, x to the right and y down the canvas. `blank(s)`: where the road is new, 0 to 1.
void PaintGround(StreetCanvas& canvas, std::uint64_t seed, const StreetPath& path, double x0, double y0,
                 const std::function<double(double)>& blank);

}  // namespace terse
