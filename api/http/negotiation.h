// SPDX-License-Identifier: GPL-3.0-or-later
//
// The headers that say what a client can take, how long it waits, and what it has already.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "api/http/http.h"

namespace spherule::api {

/// Whether `accept` (an Accept header; empty accepts all) allows `type`; its quality, 0 … 1, by the most specific
/// range.
double acceptability(std::string_view accept, std::string_view type);
/// The index of the best of `types` for this Accept header, the first among equals. Throws HttpError 406.
std::size_t negotiate(std::string_view accept, std::span<const std::string_view> types);

/// The media type of a Content-Type header without its parameters, in lower case.
std::string media_type(std::string_view content_type);
/// Whether the body is JSON by its type, or may be: curl -d says that everything is a form.
bool is_json(const Request& request);

/// `wait=N` of Prefer headers, in seconds, if any that is within ranges::wait_s; `respond-async` is wait=0.
std::optional<std::chrono::seconds> preferred_wait(const Request& request);

/// The parts of `bytes` that a Range header asks for, in its order, without those that lie outside. None when the whole
/// is to be served: no header, another unit, a malformed range, more than kMostRanges, or several that are together
/// more than the whole. Throws HttpError 416 when all lie outside.
struct ByteRange {
  std::uint64_t offset = 0, length = 0;
};
inline constexpr std::size_t kMostRanges = 32;
std::vector<ByteRange> byte_ranges(std::string_view range, std::uint64_t bytes);

/// Whether an If-None-Match header names this entity tag.
bool matches_etag(std::string_view if_none_match, std::string_view etag);

}  // namespace spherule::api
