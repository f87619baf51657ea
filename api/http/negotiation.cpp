// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/http/negotiation.h"

#include <algorithm>
#include <array>

#include "api/http/problem.h"
#include "api/http/query.h"
#include "core/base/ranges.h"
#include "core/base/text.h"

namespace spherule::api {

double acceptability(std::string_view accept, std::string_view type) {
  if (unspaced(accept).empty()) return 1;
  const std::string_view major = type.substr(0, type.find('/'));
  double quality = 0;
  int best = -1;
  each_word(accept, ',', [&](std::string_view range) {
    std::string_view media = range.substr(0, range.find(';'));
    const std::string wanted = lowered(unspaced(media));
    const int specificity = wanted == type ? 2 : wanted == std::string(major) + "/*" ? 1 : wanted == "*/*" ? 0 : -1;
    if (specificity <= best) return;
    best = specificity;
    quality = 1;
    each_word(range.substr(media.size()), ';', [&](std::string_view parameter) {
      if (lowered(parameter.substr(0, 2)) == "q=") quality = number_in<double>(parameter.substr(2)).value_or(1);
    });
  });
  return std::clamp(quality, 0.0, 1.0);
}

std::size_t negotiate(std::string_view accept, std::span<const std::string_view> types) {
  std::size_t best = types.size();
  double quality = 0;
  for (std::size_t i = 0; i < types.size(); ++i) {
    if (const double q = acceptability(accept, types[i]); q > quality) best = i, quality = q;
  }
  if (best == types.size()) {
    std::string list;
    for (const std::string_view type : types) list += (list.empty() ? "" : ", ") + std::string(type);
    throw HttpError(406, "Ask for a media type that this resource has: " + list + ".");
  }
  return best;
}

std::string media_type(std::string_view content_type) {
  return lowered(unspaced(content_type.substr(0, content_type.find(';'))));
}

bool is_json(const Request& request) {
  const std::string type = media_type(request.header("Content-Type"));
  return type.empty() || type == "application/json" || type.ends_with("+json") ||
         type == "application/x-www-form-urlencoded";
}

std::optional<std::chrono::seconds> preferred_wait(const Request& request) {
  std::optional<std::chrono::seconds> wait;
  for (const auto& [name, value] : request.headers) {
    if (lowered(name) != "prefer") continue;
    each_word(value, ',', [&](std::string_view preference) {
      const std::string word = lowered(preference.substr(0, preference.find(';')));
      // RFC 7240: the first of repeated preferences counts, malformed ones are ignored.
      if (wait) return;
      if (word == "respond-async") wait = std::chrono::seconds(0);
      if (!word.starts_with("wait=")) return;
      std::string_view number = unspaced(std::string_view(word).substr(5));
      if (number.size() > 1 && number.front() == '"' && number.back() == '"') {
        number = number.substr(1, number.size() - 2);
      }
      const auto seconds = number_in<std::int64_t>(number);
      if (seconds && ranges::wait_s.holds(*seconds)) wait = std::chrono::seconds(*seconds);
    });
  }
  return wait;
}

namespace {

// One range of a set; of no length when it lies outside, nothing when it is malformed.
std::optional<ByteRange> one_range(std::string_view range, std::uint64_t bytes) {
  const std::size_t dash = range.find('-');
  if (dash == std::string_view::npos) return std::nullopt;
  const std::string_view from = range.substr(0, dash), to = range.substr(dash + 1);
  const auto first = number_in<std::uint64_t>(from), last = number_in<std::uint64_t>(to);
  if ((!from.empty() && !first) || (!to.empty() && !last) || (!first && !last)) return std::nullopt;
  if (first && last && *last < *first) return std::nullopt;
  const std::uint64_t begin = first ? *first : bytes - std::min(bytes, *last);
  const std::uint64_t end = first && last && *last < bytes ? *last + 1 : bytes;
  return ByteRange{begin, begin < end ? end - begin : 0};
}

}  // namespace

std::vector<ByteRange> byte_ranges(std::string_view header, std::uint64_t bytes) {
  if (!header.starts_with("bytes=")) return {};
  std::vector<ByteRange> ranges;
  std::size_t asked = 0;
  std::uint64_t together = 0;
  bool good = true;
  each_word(header.substr(6), ',', [&](std::string_view text) {
    if (text.empty() || ++asked > kMostRanges) good = good && text.empty();  // elements of lists may be empty
    if (text.empty() || !good) return;
    const auto range = one_range(text, bytes);
    good = range.has_value();
    if (!good || range->length == 0) return;
    ranges.push_back(*range);
    together += range->length;
  });
  // Who asks for more than there is gets what there is.
  if (!good || asked == 0 || (ranges.size() > 1 && together > bytes)) return {};
  if (ranges.empty()) {
    throw HttpError(416, "Ask for a range within the content's " + std::to_string(bytes) + " bytes.",
                    {{"Content-Range", "bytes */" + std::to_string(bytes)}});
  }
  return ranges;
}

bool matches_etag(std::string_view if_none_match, std::string_view etag) {
  bool found = unspaced(if_none_match) == "*";
  each_word(if_none_match, ',', [&](std::string_view tag) {
    if (tag.starts_with("W/")) tag.remove_prefix(2);
    found = found || tag == etag;
  });
  return found;
}

}  // namespace spherule::api
