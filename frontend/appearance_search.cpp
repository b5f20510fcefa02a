#include "terse/frontend/appearance_search.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <stdexcept>

namespace terse {
namespace {

using std::size_t;

// A number per bit, so that the squared Euclidean distance is the Hamming distance.
void Unpack(const BinaryDescriptor& descriptor, float* out) {
  for (const std::uint64_t word : descriptor) {
    for (int bit = 0; bit < 64; ++bit) *out++ = static_cast<float>((word >> bit) & 1);
  }
}

cv::Mat Unpack(const std::vector<BinaryDescriptor>& descriptors, size_t most) {
  const size_t rows = std::min(descriptors.size(), most);
  cv::Mat out(static_cast<int>(rows), 256, CV_32F);
  for (size_t k = 0; k < rows; ++k) {
    Unpack(descriptors[k * descriptors.size() / rows], out.ptr<float>(static_cast<int>(k)));
  }
  return out;
}

}  // namespace

AppearanceSearch::AppearanceSearch(const std::vector<BinaryDescriptor>& descriptors, const AppearanceOptions& options)
    : options_(options) {
  if (options.words < 1 || options.most_trained < options.words || options.iterations < 1 ||
      options.most_candidates < 0 || options.gap < 0) {
    throw std::invalid_argument("appearance options: a number is out of its domain");
  }
  if (descriptors.size() < static_cast<size_t>(options.words)) {
    throw std::invalid_argument("appearance search: " + std::to_string(descriptors.size()) +
                                " descriptors are too few for a vocabulary of " + std::to_string(options.words));
  }
  cv::setRNGSeed(1);  // k-means++ draws from OpenCV's generator
  const cv::TermCriteria stop(cv::TermCriteria::COUNT, options.iterations, 0);
  const cv::BOWKMeansTrainer trainer(options.words, stop, 1, cv::KMEANS_PP_CENTERS);
  words_ = trainer.cluster(Unpack(descriptors, static_cast<size_t>(options.most_trained)));
  cv::reduce(words_.mul(words_), squares_, 1, cv::REDUCE_SUM);
  occurs_in_.assign(static_cast<size_t>(words_.rows), 0);
}

AppearanceSearch::Histogram AppearanceSearch::Describe(const KeyframeFeatures& features) const {
  Histogram out;
  if (features.Size() == 0) return out;
  // |d - w|^2 = |d|^2 - 2 d w + |w|^2, of which the first does not matter.
  cv::Mat products;
  cv::gemm(Unpack(features.descriptors, features.Size()), words_, -2, {}, 0, products, cv::GEMM_2_T);
  for (int row = 0; row < products.rows; ++row) {
    int nearest = 0;
    float least = 0;
    for (int word = 0; word < words_.rows; ++word) {
      const float distance = products.at<float>(row, word) + squares_.at<float>(word);
      if (word == 0 || distance < least) least = distance, nearest = word;
    }
    out[nearest] += 1 / static_cast<double>(features.Size());
  }
  return out;
}

// Rare words tell more; one that every keyframe has still tells something.
double AppearanceSearch::Weight(int word) const {
  const int keyframes = std::max(1, occurs_in_[static_cast<size_t>(word)]);
  return std::log(1 + static_cast<double>(keyframes_.size()) / keyframes);
}

std::vector<AppearanceSearch::Match> AppearanceSearch::Query(const KeyframeFeatures& features) const {
  std::vector<Match> out;
  const auto length = [&](const Histogram& histogram) {
    double sum = 0;
    for (const auto& [word, share] : histogram) sum += std::pow(share * Weight(word), 2);
    return std::sqrt(sum);
  };
  const Histogram asked = Describe(features);
  const double asked_length = length(asked);
  for (size_t k = 0; k + static_cast<size_t>(options_.gap) < keyframes_.size(); ++k) {
    const auto& [id, histogram] = keyframes_[k];
    double product = 0;
    for (const auto& [word, share] : histogram) {
      const auto it = asked.find(word);
      if (it != asked.end()) product += share * it->second * std::pow(Weight(word), 2);
    }
    const double lengths = asked_length * length(histogram);
    const double similarity = lengths > 0 ? product / lengths : 0;
    if (similarity >= options_.min_similarity) out.push_back({id, similarity});
  }
  std::stable_sort(out.begin(), out.end(), [](const Match& a, const Match& b) { return a.similarity > b.similarity; });
  if (out.size() > static_cast<size_t>(options_.most_candidates)) {
    out.resize(static_cast<size_t>(options_.most_candidates));
  }
  return out;
}

void AppearanceSearch::Add(PoseId id, const KeyframeFeatures& features) {
  keyframes_.emplace_back(id, Describe(features));
  for (const auto& entry : keyframes_.back().second) ++occurs_in_[static_cast<size_t>(entry.first)];
}

}  // namespace terse
