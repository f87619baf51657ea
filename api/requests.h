// SPDX-License-Identifier: GPL-3.0-or-later
//
// What a request says, checked: query parameters, JSON bodies, and the headers that negotiate. Whatever is unknown is
// refused by name.
#pragma once

#include <chrono>
#include <initializer_list>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "api/http/http.h"
#include "core/base/ranges.h"

namespace spherule::api {

/// Whether text is well-formed UTF-8 (RFC 3629).
bool is_utf8(std::string_view text);

/// The query parameters of a request, of which only `known` may occur, each once and in UTF-8. The functions throw
/// invalid_argument with the parameter's name as pointer.
class Query {
 public:
  Query(const Request& request, std::initializer_list<std::string_view> known)
      : Query(request, std::span(known.begin(), known.size())) {}
  Query(const Request& request, std::span<const std::string_view> known);

  std::optional<std::string> text(std::string_view name) const;
  /// A whole number of the range.
  std::optional<std::int64_t> integer(std::string_view name, const ranges::Whole& range) const;
  /// Exactly `count` numbers of the range, with commas between.
  std::optional<std::vector<double>> numbers(std::string_view name, std::size_t count, const ranges::Real& range) const;
  /// One of `choices`.
  std::optional<std::string> choice(std::string_view name, std::initializer_list<std::string_view> choices) const;

 private:
  const Request& request_;
};

/// `?limit=&cursor=`, limit within 1 … 1000, default 100.
PageRequest page_request(const Query& query);

/// `?rows=`, `?columns=` (names of figures with commas between, each once; those that the rows are for where it is
/// absent) and `?order=`.
SphereListing sphere_listing(const Query& query);

/// `?levels=`: ascending whole numbers with commas between. Empty when absent.
std::vector<std::uint32_t> tree_levels(const Query& query);

/// `?upload=`: ids with commas between; empty for none.
std::vector<std::string> upload_ids(const Request& request);

/// `?format=raw&dims=&dtype=&spacing=&origin=&endian=`, `?frame=`, `?grid=`; `?upload=` beside
/// these, and no other.
VolumeParameters volume_parameters(const Request& request);

/// The options of core/render/options.h, `?with=` and `?level=`, and no other. Throws what check_render_options throws
/// too.
std::pair<RenderRequest, std::uint32_t> render_request(const Request& request);
/// The query that asks for this picture: what differs from the defaults.
std::string query_of(const RenderRequest& request);

/// `?format=`, or what the Accept header likes best: json, png or svg, the first of `order` among equals. Throws
/// HttpError 406.
FigureFormat figure_format(const Request& request, const Query& query, std::span<const FigureFormat> order);
std::string_view media_type(FigureFormat format);

/// `?threshold=`, `?range=` or `?labels=`, with `?inside=` and `?border=`; nothing when none of the first three is
/// there. `natural` is the inside of a threshold when none is named.
std::optional<ObjectRule> object_rule(const Query& query, Side natural);

/// A slice of this volume, by the path's axis and index, an object_rule, the options of core/render/options.h and
/// `?format=`, and no other. Throws not_found for a slice that the volume does not have, and what check_slice_options
/// throws.
SliceRequest slice_request(const Request& request, const VolumeInfo& volume, std::string_view axis,
                           std::string_view index);
/// The query that asks for this slice: its object, its format and what differs from the defaults.
std::string query_of(const SliceRequest& request);

/// The options of a file's format (core/write/export_file.h) and `?level=` (0 when absent), and no other.
std::pair<FileRequest, std::uint32_t> file_request(const Request& request, FileFormat format);
/// The query that asks for this file: what differs from the defaults.
std::string query_of(const FileRequest& request);

/// The body of POST /v1/models as it was sent.
struct ModelWish {
  std::string volume;
  ObjectRule rule;
  bool side_given = false;  ///< else rule.side is still to be filled in
};
/// Throws malformed for text that is not JSON, invalid_argument with a JSON pointer for every field that is unknown,
/// missing or of the wrong kind.
ModelWish model_wish(std::string_view json);

/// The body of POST /v1/models/{model}/simplifications. Throws malformed and invalid_argument likewise.
SimplifyMethod simplify_wish(std::string_view json);

/// The body of POST /v1/registrations. Throws like model_wish, and what check_registration_options throws.
RegistrationRequest registration_wish(std::string_view json);
/// The options of core/render/options.h but for two models' layout and turns, and `?of=models|spheres`.
BeforeAfterRequest before_after_request(const Request& request);
std::string query_of(const BeforeAfterRequest& request);
/// `{"what": "volume" | "model"}`, or nothing: the volume.
AppliedRequest applied_wish(std::string_view json);

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
