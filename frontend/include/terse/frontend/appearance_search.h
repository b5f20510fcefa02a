#pragma once
// Which earlier keyframes look like this one? Bags of visual words (Sivic and Zisserman, ICCV 2003): the usual way to
// find loop candidates, here to compare the search by distance and information with (S, section 7).
//
// A vocabulary is found by k-means (OpenCV's BOWKMeansTrainer) on descriptors of the sequence itself, which favours
// it: at the time of its first frames no one knows them. Each keyframe becomes a histogram of words, weighted by how
// rare they are among the keyframes so far (tf-idf), and is compared by the cosine of the angle between two of them.

#include <map>
#include <vector>

#include "terse/core/pose_graph.h"
#include "terse/frontend/keyframe_features.h"

namespace terse {

struct AppearanceOptions {
  int words = 400;
  int most_trained = 8000;       // descriptors, spread over those given
  int iterations = 8;            // of k-means
  double min_similarity = 0.25;  // cosine
  int most_candidates = 5;       // in answer to one query
  int gap = 30;                  // of the newest keyframes, which always look alike, so many are not compared
};

class AppearanceSearch {
 public:
  // Throws std::invalid_argument if there are fewer descriptors than words, or an option makes no sense.
  explicit AppearanceSearch(const std::vector<BinaryDescriptor>& descriptors, const AppearanceOptions& options = {});

  struct Match {
    PoseId id;
    double similarity = 0;
  };
  // The most similar keyframes, best first. O(keyframes * words of one).
  std::vector<Match> Query(const KeyframeFeatures& features) const;
  void Add(PoseId id, const KeyframeFeatures& features);
  int Words() const { return words_.rows; }

 private:
  using Histogram = std::map<int, double>;  // word -> share
  Histogram Describe(const KeyframeFeatures& features) const;
  double Weight(int word) const;

  AppearanceOptions options_;
  cv::Mat words_;    // CV_32F, a row each, one number per bit
  cv::Mat squares_;  // their squared lengths
  std::vector<std::pair<PoseId, Histogram>> keyframes_;
  std::vector<int> occurs_in_;  // keyframes, of each word
};

}  // namespace terse
