#pragma once
// PNG images as grey values, by libpng alone: opencv_imgcodecs would bring every format's library along.

#include <opencv2/core/mat.hpp>
#include <string>

namespace terse {

// Any PNG as 8-bit grey (CV_8U): colour weighted as luma, 16 bits cut to 8, transparency and gamma ignored. Throws
// FileError if the file is missing, no PNG, cut off, damaged or larger than 2^28 pixels.
cv::Mat ReadGreyPng(const std::string& path);

// Writes 8-bit grey values, fast rather than small; equal images give equal bytes. Throws FileError, and leaves no
// file, if they cannot be written; std::invalid_argument if the image is empty or not CV_8U.
void WriteGreyPng(const std::string& path, const cv::Mat& image);

}  // namespace terse
