#pragma once
// `terse kitti` and `terse generate stereo` are run by a program of their own, terse-stereo: loading OpenCV takes
// longer than most of what the other subcommands do. It is the same command, linked with the stereo front end.

#include <string>

namespace terse {

constexpr const char* kKittiDescription = "A compact map from a stereo sequence in KITTI's layout";
constexpr const char* kGenerateStereoDescription =
    "Render laps round a block as a KITTI sequence: image_0, image_1, calib.txt, times.txt and poses.txt, the exact "
    "ground truth of the left camera";

// What these subcommands throw where the front end is not linked.
struct StereoProgramAsked {};

// Whether it is where it belongs, seen from the program that runs; terse-stereo sees none.
bool HasStereoProgram();

// Goes on as terse-stereo with the same arguments. Returns why, if it cannot be run.
std::string RunStereoProgram(char** argv);

}  // namespace terse
