// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the parameters of each resource say, as values. The functions throw invalid_argument with the parameter's name
// as pointer.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "api/http/query.h"
#include "api/things.h"
#include "api/work.h"

namespace spherule::api {

/// `?limit=&cursor=`, limit within 1 … 1000, default 100.
PageRequest page_request(const Query& query);

/// `?rows=`, `?columns=` (names of figures with commas between, each once; those that the rows are for where it is
/// absent) and `?order=`.
SphereListing sphere_listing(const Query& query);

/// `?levels=`: ascending whole numbers with commas between. Empty when absent.
std::vector<std::uint32_t> tree_levels(const Query& query);

/// `?upload=`: ids with commas between; empty for none.
std::vector<std::string> upload_ids(const Request& request);

/// `?format=raw&dims=&dtype=&spacing=&origin=&endian=`, `?frame=`, `?grid=`; `?upload=` beside these, and no other.
VolumeParameters volume_parameters(const Request& request);

/// The options of core/render/options.h, `?with=` and `?level=`, and no other. Throws what check_render_options throws
/// too.
std::pair<RenderRequest, std::uint32_t> render_request(const Request& request);
/// `?format=`, or what the Accept header likes best: json, png or svg, the first of `order` among equals. Throws
/// HttpError 406.
FigureFormat figure_format(const Request& request, const Query& query, std::span<const FigureFormat> order);

/// `?threshold=`, `?range=` or `?labels=`, with `?inside=` and `?border=`; nothing when none of the first three is
/// there. `natural` is the inside of a threshold when none is named.
std::optional<ObjectRule> object_rule(const Query& query, Side natural);

/// A slice of this volume, by the path's axis and index, an object_rule, the options of core/render/options.h and
/// `?format=`, and no other. Throws not_found for a slice that the volume does not have, and what check_slice_options
/// throws.
SliceRequest slice_request(const Request& request, const VolumeInfo& volume, std::string_view axis,
                           std::string_view index);
/// The options of a file's format (core/write/export_file.h) and `?level=` (0 when absent), and no other.
std::pair<FileRequest, std::uint32_t> file_request(const Request& request, FileFormat format);
/// The options of core/render/options.h but for two models' layout and turns, and `?of=models|spheres`.
BeforeAfterRequest before_after_request(const Request& request);

}  // namespace spherule::api
