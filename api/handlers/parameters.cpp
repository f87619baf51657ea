// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/handlers/parameters.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "api/http/negotiation.h"
#include "core/base/error.h"
#include "core/base/ranges.h"
#include "core/base/text.h"
#include "core/render/options.h"

namespace spherule::api {

PageRequest page_request(const Query& query) {
  return {.limit = static_cast<std::size_t>(query.integer("limit", ranges::page).value_or(100)),
          .cursor = query.text("cursor").value_or("")};
}

SphereListing sphere_listing(const Query& query) {
  SphereListing listing;
  const std::string columns = query.text("columns").value_or("");
  each_word(columns, ',', [&](std::string_view word) {
    const auto figure = std::ranges::find(sphere_figures, word, [](SphereFigure f) { return name(f); });
    if (figure == sphere_figures.end()) {
      std::string known;
      for (const SphereFigure f : sphere_figures) known += (known.empty() ? "" : ", ") + std::string(name(f));
      refuse_parameter("columns",
                       "Give names out of " + known + ", with commas between; x, y, z and r are always there.");
    }
    if (std::ranges::find(listing.columns, *figure) != listing.columns.end()) {
      refuse_parameter("columns", "Name every column once.");
    }
    listing.columns.push_back(*figure);
  });
  if (query.choice("order", {"index", "contribution"}) == "contribution") listing.order = SphereOrder::contribution;
  const auto rows = query.choice("rows", {"spheres", "nodes", "members"});
  if (rows == "nodes") listing.rows = SphereRows::nodes;
  if (rows == "members") listing.rows = SphereRows::members;
  using enum SphereFigure;
  if (!query.text("columns") && listing.rows == SphereRows::nodes) {
    listing.columns = {node, parent, level_from, level_to, members};
  }
  if (!query.text("columns") && listing.rows == SphereRows::members) listing.columns = {cluster};
  if (listing.rows != SphereRows::spheres && listing.order != SphereOrder::index) {
    refuse_parameter("order", "Rows that are nodes or members come by index; leave order out.");
  }
  for (const SphereFigure figure : listing.columns) {
    if (listing.rows == SphereRows::members ? figure != index && figure != cluster
                                            : figure == cluster || (listing.rows == SphereRows::nodes &&
                                                                    (is_contribution(figure) || figure == index))) {
      refuse_parameter("columns",
                       "There is no " + std::string(name(figure)) +
                           " of such rows: of members there are index and "
                           "cluster, of nodes node, parent, level_from, level_to and members, of spheres all but "
                           "cluster.");
    }
  }
  if (listing.rows == SphereRows::nodes && query.text("level")) {
    refuse_parameter("level", "Nodes are of all levels; leave level out.");
  }
  return listing;
}

std::vector<std::uint32_t> tree_levels(const Query& query) {
  std::vector<std::uint32_t> levels;
  const auto given = query.text("levels");
  if (!given) return levels;
  each_word(*given, ',', [&](std::string_view word) {
    const auto level = number_in<std::uint32_t>(word);
    if (!level || !ranges::level.holds(*level) || levels.size() == 1000 ||
        (!levels.empty() && *level <= levels.back())) {
      refuse_parameter("levels", "Give ascending whole numbers above zero with commas between, at most 1000.");
    }
    levels.push_back(*level);
  });
  if (levels.empty()) refuse_parameter("levels", "Give at least one level, such as 1,8,64.");
  return levels;
}

std::vector<std::string> upload_ids(const Request& request) {
  std::vector<std::string> ids;
  for (const auto& [name, value] : request.query) {
    if (name != "upload") continue;
    each_word(value, ',', [&](std::string_view id) { ids.emplace_back(id); });
    if (ids.empty()) refuse_parameter("upload", "Give the ids of finished uploads, with commas between.");
  }
  return ids;
}

VolumeParameters volume_parameters(const Request& request) {
  const Query query(request, {"format", "dims", "dtype", "spacing", "origin", "endian", "frame", "grid", "upload"});
  VolumeParameters parameters;
  if (query.choice("format", {"raw"})) {
    RawLayout raw;
    const ranges::Real sizes{static_cast<double>(ranges::dim.least), static_cast<double>(ranges::dim.most)};
    const auto dims = query.numbers("dims", 3, sizes);
    if (!dims) refuse_parameter("dims", "Raw samples need their sizes: dims=nx,ny,nz.");
    for (std::size_t a = 0; a < 3; ++a) {
      const double n = (*dims)[a];
      if (n != std::floor(n)) refuse_parameter("dims", "Every size must be a whole number above zero.");
      raw.dims[a] = static_cast<std::int32_t>(n);
    }
    const auto dtype = query.text("dtype");
    if (!dtype) refuse_parameter("dtype", "Raw samples need their type, by NumPy's name: dtype=uint8.");
    try {
      raw.type = voxel_type(*dtype);
    } catch (const Error& error) {
      refuse_parameter("dtype", error.what());
    }
    if (const auto spacing = query.numbers("spacing", 3, ranges::spacing_mm))
      raw.spacing = {(*spacing)[0], (*spacing)[1], (*spacing)[2]};
    if (const auto origin = query.numbers("origin", 3, ranges::origin_mm))
      raw.origin = {(*origin)[0], (*origin)[1], (*origin)[2]};
    raw.big_endian = query.choice("endian", {"little", "big"}) == "big";
    parameters.raw = raw;
  } else {
    for (const std::string_view name : {"dims", "dtype", "spacing", "origin", "endian"}) {
      if (query.text(name)) refuse_parameter(name, "This parameter describes headerless samples; add format=raw.");
    }
  }
  if (const auto frame = query.integer("frame", ranges::index)) parameters.frame = static_cast<int>(*frame);
  parameters.grid = query.text("grid").value_or("");
  if (parameters.raw && (parameters.frame || !parameters.grid.empty())) {
    refuse_parameter(parameters.frame ? "frame" : "grid",
                     "Headerless samples are one volume; leave this parameter out.");
  }
  return parameters;
}

std::pair<RenderRequest, std::uint32_t> render_request(const Request& request) {
  std::vector<std::string_view> known(render_option_names().begin(), render_option_names().end());
  known.push_back("with");
  known.push_back("level");
  const Query query(request, known);
  RenderRequest wanted;
  wanted.with = query.text("with").value_or("");
  OptionTexts given = request.query;
  std::erase_if(given, [](const auto& pair) { return pair.first == "with" || pair.first == "level"; });
  wanted.options = parse_render_options(given);
  if (wanted.with.empty() && query.text("layout"))
    refuse_parameter("layout", "This is for a second model: with=mdl_….");
  check_render_options(wanted.options);
  return {wanted, static_cast<std::uint32_t>(query.integer("level", ranges::level).value_or(0))};
}

namespace {

constexpr auto kRuleNames = std::to_array<std::string_view>({"threshold", "range", "labels", "inside", "border"});

std::vector<Label> labels_of(std::string_view text) {
  std::vector<Label> labels;
  bool good = true;
  each_word(text, ',', [&](std::string_view word) {
    const auto label = parse_label(word);
    good = good && label && labels.size() < 65536;
    if (good) labels.push_back(*label);
  });
  if (!good || labels.empty()) refuse_parameter("labels", "Give whole numbers with commas between.");
  std::ranges::sort(labels);
  labels.erase(std::ranges::unique(labels).begin(), labels.end());
  return labels;
}

}  // namespace

FigureFormat figure_format(const Request& request, const Query& query, std::span<const FigureFormat> order) {
  FigureFormat asked;
  if (const auto word = query.choice("format", {"json", "png", "svg"})) {
    asked = *std::ranges::find(figure_formats, *word, [](FigureFormat format) { return name(format); });
    order = std::span(&asked, 1);
  }
  std::vector<std::string_view> types;
  for (const FigureFormat format : order) types.push_back(media_type(format));
  return order[negotiate(request.header("Accept"), types)];
}

std::optional<ObjectRule> object_rule(const Query& query, Side natural) {
  const auto threshold = query.numbers("threshold", 1, ranges::value);
  const auto range = query.numbers("range", 2, ranges::value);
  const auto labels = query.text("labels");
  const auto inside = query.choice("inside", {"above", "below"}), border = query.choice("border", {"closed", "open"});
  const int objects = (threshold ? 1 : 0) + (range ? 1 : 0) + (labels ? 1 : 0);
  if (objects > 1) refuse_parameter(threshold ? "threshold" : "range", "Give one of threshold, range and labels.");
  if (objects == 0) {
    if (inside || border)
      refuse_parameter(inside ? "inside" : "border", "This is for an object; give threshold, range or labels.");
    return std::nullopt;
  }
  ObjectRule rule;
  if (threshold) {
    rule.lo = threshold->front();
    rule.side = natural;
  } else if (range) {
    rule.kind = ObjectRule::Kind::range;
    rule.lo = range->front(), rule.hi = range->back();
    if (rule.lo > rule.hi) refuse_parameter("range", "Give two numbers lo,hi with lo no greater than hi.");
  } else {
    rule.kind = ObjectRule::Kind::labels;
    rule.labels = labels_of(*labels);
  }
  if (inside) rule.side = *inside == "below" ? Side::below : Side::above;
  if (border == "open") rule.border = Border::open;
  return rule;
}

SliceRequest slice_request(const Request& request, const VolumeInfo& volume, std::string_view axis,
                           std::string_view index) {
  std::vector<std::string_view> known(kRuleNames.begin(), kRuleNames.end());
  known.push_back("format");
  known.insert(known.end(), slice_option_names().begin(), slice_option_names().end());
  const Query query(request, known);
  SliceRequest wanted;
  if (axis.size() != 1 || axis[0] < 'i' || axis[0] > 'k')
    throw Error(ErrorCode::not_found, "There is no such axis; slices are numbered along the grid's axes i, j and k.");
  wanted.axis = axis[0] - 'i';
  const std::int32_t count = volume.grid.dims[static_cast<std::size_t>(wanted.axis)];
  const auto number = number_in<std::int32_t>(index);
  if (!number || *number < 0 || *number >= count) {
    throw Error(ErrorCode::not_found, "There is no such slice; along " + std::string(axis) +
                                          " the volume has slices 0 to " + std::to_string(count - 1) + ".");
  }
  wanted.index = *number;
  wanted.object = object_rule(query, volume.natural_side);
  constexpr std::array kOrder{FigureFormat::png, FigureFormat::svg, FigureFormat::json};
  wanted.format = figure_format(request, query, kOrder);
  OptionTexts given = request.query;
  std::erase_if(given, [](const auto& pair) {
    return pair.first == "format" || std::ranges::find(kRuleNames, pair.first) != kRuleNames.end();
  });
  const SliceOptions options = parse_slice_options(given);
  check_slice_options(options);
  if (!wanted.object && query.text("show"))
    refuse_parameter("show", "Name the object that is shown: threshold, range or labels.");
  if (!wanted.object && !options.image) refuse_parameter("image", "Without it only an object can be drawn; name one.");
  // Numbers do not depend on how they could be drawn.
  if (wanted.format != FigureFormat::json) wanted.options = options;
  return wanted;
}

std::pair<FileRequest, std::uint32_t> file_request(const Request& request, FileFormat format) {
  std::vector<std::string_view> known(file_option_names(format).begin(), file_option_names(format).end());
  known.push_back("level");
  const Query query(request, known);
  OptionTexts given = request.query;
  std::erase_if(given, [](const auto& pair) { return pair.first == "level"; });
  return {{format, parse_file_options(format, given)},
          static_cast<std::uint32_t>(query.integer("level", ranges::level).value_or(0))};
}

BeforeAfterRequest before_after_request(const Request& request) {
  std::vector<std::string_view> known;
  for (const std::string_view name : render_option_names())
    if (name != "layout" && name != "turntable") known.push_back(name);
  known.push_back("of");
  const Query query(request, known);
  BeforeAfterRequest wanted;
  wanted.few = query.choice("of", {"models", "spheres"}) == "spheres";
  OptionTexts given = request.query;
  std::erase_if(given, [](const auto& pair) { return pair.first == "of"; });
  wanted.options = parse_render_options(given);
  wanted.options.layout = Layout::overlaid;
  check_render_options(wanted.options);
  return wanted;
}

}  // namespace spherule::api
