// SPDX-License-Identifier: GPL-3.0-or-later
//
// Methods in words (simplify.h).
#include <algorithm>
#include <array>
#include <string>

#include "core/base/ranges.h"
#include "core/base/text.h"
#include "core/simplify/simplify.h"

namespace spherule {

namespace {

using Words = std::span<const std::string_view>;

constexpr auto kMethods = std::to_array<std::string_view>({"sphericity", "median", "average", "prune", "best"});
// In the order of the enumerators.
constexpr auto kRepresentatives = std::to_array<std::string_view>({"enclosing", "largest", "mean", "volume"});
constexpr auto kModes = std::to_array<std::string_view>({"inner", "best", "outer"});
constexpr auto kNames =
    std::to_array<std::string_view>({"method", "threshold", "limit", "representative", "k", "least_radius_mm",
                                     "buckets", "bucket_count", "volume_share", "mode", "iou"});

// Takes options one by one; what nobody took is an error, and all errors are thrown together.
class Given {
 public:
  explicit Given(const OptionTexts& texts) : texts_(texts), taken_(texts.size(), false) {}

  void take(std::string_view name, const ranges::Real& range, double& value) {
    const auto text = find(name);
    if (!text) return;
    const auto number = number_in<double>(*text);
    if (!number || !range.holds(*number)) return refuse(name, "Give a number " + range.words() + ".");
    value = *number;
  }
  void take(std::string_view name, const ranges::Whole& range, std::uint32_t& value) {
    const auto text = find(name);
    if (!text) return;
    const auto number = number_in<std::uint32_t>(*text);
    if (!number || !range.holds(*number)) return refuse(name, "Give a whole number " + range.words() + ".");
    value = *number;
  }
  template <typename Range, typename T>
  void take(std::string_view name, const Range& range, std::optional<T>& value) {
    if (has(name)) take(name, range, value.emplace());
  }
  void take(std::string_view name, std::vector<std::uint32_t>& values) {
    const auto text = find(name);
    if (!text) return;
    for (const std::string_view part : split(*text, ',')) {
      const auto number = number_in<std::uint32_t>(part);
      if (!number || *number >= ranges::buckets.most)
        return refuse(name, "Give numbers of buckets, counted from 0, at least one.");
      values.push_back(*number);
    }
    std::ranges::sort(values);
    values.erase(std::ranges::unique(values).begin(), values.end());
  }
  // The number of the word given.
  std::optional<std::size_t> take(std::string_view name, Words words) {
    const auto text = find(name);
    if (!text) return std::nullopt;
    const auto found = std::ranges::find(words, *text);
    if (found != words.end()) return static_cast<std::size_t>(found - words.begin());
    refuse(name, "Give one of " + listed(words) + ".");
    return std::nullopt;
  }
  void take(std::string_view name, Representative& value) {
    if (const auto word = take(name, Words(kRepresentatives))) value = static_cast<Representative>(*word);
  }
  void take(std::string_view name, BestOptions::Mode& value) {
    if (const auto word = take(name, Words(kModes))) value = static_cast<BestOptions::Mode>(*word);
  }

  bool has(std::string_view name) const {
    return std::ranges::any_of(texts_, [&](const auto& text) { return text.first == name; });
  }
  void refuse(std::string_view name, const std::string& detail) {
    errors_.push_back({"/" + std::string(name.substr(0, 100)), detail});
  }
  // `method` is empty when it is not known, and then its options are not either.
  void done(std::string_view method) {
    for (std::size_t i = 0; i < texts_.size(); ++i) {
      const std::string& name = texts_[i].first;
      if (std::ranges::find(kNames, name) == kNames.end()) {
        refuse(name, "There is no such field; known are " + listed(kNames) + ".");
      } else if (taken_[i]) {
        const auto same = [&](const auto& text) { return text.first == name; };
        if (std::ranges::count_if(texts_, same) > 1) refuse(name, "Give this field once.");
      } else if (!method.empty()) {
        refuse(name, "The method " + std::string(method) + " has no such field.");
      }
    }
    if (errors_.empty()) return;
    std::string sentence = "Correct ";
    constexpr std::size_t kTold = 10;
    for (std::size_t i = 0; i < std::min(kTold, errors_.size()); ++i) {
      sentence += (i > 0 ? " " : "") + errors_[i].pointer.substr(1) + ": " + errors_[i].detail;
    }
    if (errors_.size() > kTold) sentence += " And so on: there are " + std::to_string(errors_.size()) + " such errors.";
    throw Error(ErrorCode::invalid_argument, sentence, std::move(errors_));
  }

 private:
  std::optional<std::string_view> find(std::string_view name) {
    std::optional<std::string_view> found;
    for (std::size_t i = 0; i < texts_.size(); ++i) {
      if (texts_[i].first != name || found) continue;
      found = texts_[i].second;
      taken_[i] = true;
    }
    return found;
  }

  const OptionTexts& texts_;
  std::vector<bool> taken_;
  std::vector<FieldError> errors_;
};

}  // namespace

std::span<const std::string_view> method_option_names() { return kNames; }

SimplifyMethod parse_method(const OptionTexts& texts) {
  Given given(texts);
  const auto word = given.take("method", Words(kMethods));
  if (!given.has("method")) given.refuse("method", "Give one of " + listed(kMethods) + ".");
  if (!word) given.done({});
  const std::string_view name = kMethods[*word];
  SimplifyMethod method;
  if (name == "sphericity") {
    auto& o = method.emplace<SphericityOptions>();
    given.take("threshold", ranges::share, o.threshold);
    given.take("limit", ranges::count, o.limit);
    given.take("representative", o.representative);
  } else if (name == "prune") {
    auto& o = method.emplace<PruneOptions>();
    given.take("least_radius_mm", ranges::length_mm, o.least_radius_mm);
    given.take("buckets", o.buckets);
    given.take("bucket_count", ranges::buckets, o.bucket_count);
    if (given.has("bucket_count") && !given.has("buckets")) given.refuse("bucket_count", "This is for buckets.");
    given.take("volume_share", ranges::share, o.volume_share);
    given.take("k", ranges::count, o.k);
  } else if (name == "best") {
    auto& o = method.emplace<BestOptions>();
    given.take("mode", o.mode);
    given.take("k", ranges::best_count, o.k);
    given.take("iou", ranges::share, o.iou);
  } else {
    auto& o = method.emplace<SplittingOptions>();
    o.at = name == "median" ? SplittingOptions::At::median : SplittingOptions::At::average;
    given.take("k", ranges::count, o.k);
    given.take("representative", o.representative);
  }
  given.done(name);
  return method;
}

OptionTexts method_texts(const SimplifyMethod& method) {
  struct Visitor {
    static std::string word(Representative r) { return std::string(kRepresentatives[static_cast<std::size_t>(r)]); }

    OptionTexts operator()(const SphericityOptions& o) const {
      return {{"method", "sphericity"},
              {"threshold", text_of(o.threshold)},
              {"limit", text_of(o.limit)},
              {"representative", word(o.representative)}};
    }
    OptionTexts operator()(const SplittingOptions& o) const {
      return {{"method", o.at == SplittingOptions::At::median ? "median" : "average"},
              {"k", text_of(o.k)},
              {"representative", word(o.representative)}};
    }
    OptionTexts operator()(const PruneOptions& o) const {
      OptionTexts texts{{"method", "prune"}};
      if (o.least_radius_mm) texts.emplace_back("least_radius_mm", text_of(*o.least_radius_mm));
      if (!o.buckets.empty()) {
        std::string list;
        for (const std::uint32_t b : o.buckets) list += (list.empty() ? "" : ",") + text_of(b);
        texts.emplace_back("buckets", list);
        texts.emplace_back("bucket_count", text_of(o.bucket_count));
      }
      if (o.volume_share) texts.emplace_back("volume_share", text_of(*o.volume_share));
      if (o.k) texts.emplace_back("k", text_of(*o.k));
      return texts;
    }
    OptionTexts operator()(const BestOptions& o) const {
      OptionTexts texts{{"method", "best"}, {"mode", std::string(kModes[static_cast<std::size_t>(o.mode)])}};
      if (o.k) texts.emplace_back("k", text_of(*o.k));
      if (o.iou) texts.emplace_back("iou", text_of(*o.iou));
      return texts;
    }
  };
  return std::visit(Visitor{}, method);
}

}  // namespace spherule
