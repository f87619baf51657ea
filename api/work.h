// SPDX-License-Identifier: GPL-3.0-or-later
//
// What can be asked for that takes work: models, registrations, and what is derived from them. Requests are values;
// what they make is stored under an id that is a digest of them (api/json/work.h), so equal requests are one result.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "core/inside.h"
#include "core/register/register.h"
#include "core/render/render.h"
#include "core/render/slice_picture.h"
#include "core/simplify/simplify.h"
#include "core/write/export_file.h"

namespace spherule::api {

/// The model of an object of a volume. `rule.side` is the volume's natural_side when the user named none.
struct ModelRequest {
  std::string volume;
  ObjectRule rule;
};

/// A simpler model of a model.
struct SimplificationRequest {
  std::string model;
  SimplifyMethod method;
};

/// The transform that lays one model on another.
struct RegistrationRequest {
  std::string fixed, moving;  ///< ids of models
  RegistrationOptions options{};
};

// ------------------------------------------------------------------------------------------- what is derived from them

enum class SphereFormat : std::uint8_t { csv, npy, ply, vtp };

/// What can be told of a sphere beside x, y, z and r.
enum class SphereFigure : std::uint8_t {
  index,  ///< in the model or in its level, from 0
  // These five need the union to be measured.
  volume_mm3,        ///< its part of the union: the ball within its power cell
  area_mm2,          ///< its part of the union's surface
  share,             ///< its part of the union's volume, 0 … 1
  rank,              ///< by volume_mm3, from 1
  cumulative_share,  ///< of the spheres up to this rank
  // Of a simplified model's spheres.
  node,        ///< its place among the spheres of all levels, from 0
  parent,      ///< the node that it refines, or -1
  level_from,  ///< the first level that shows it
  level_to,    ///< the last one
  members,     ///< how many of the source model's spheres it stands for
  // Of a source model's spheres.
  cluster,  ///< index of the simplified sphere that stands for it, or -1
};
inline constexpr std::array sphere_figures{
    SphereFigure::index,      SphereFigure::volume_mm3,       SphereFigure::area_mm2, SphereFigure::share,
    SphereFigure::rank,       SphereFigure::cumulative_share, SphereFigure::node,     SphereFigure::parent,
    SphereFigure::level_from, SphereFigure::level_to,         SphereFigure::members,  SphereFigure::cluster};
constexpr bool is_contribution(SphereFigure f) {
  return f >= SphereFigure::volume_mm3 && f <= SphereFigure::cumulative_share;
}
constexpr bool is_of_levels(SphereFigure f) { return f >= SphereFigure::node && f <= SphereFigure::members; }

enum class SphereOrder : std::uint8_t { index, contribution };

/// What the rows of a listing are. All but `spheres` are for simplified models.
enum class SphereRows : std::uint8_t {
  spheres,  ///< of the model, or of the level asked for
  nodes,    ///< of all levels
  members,  ///< of the source model
};

/// How spheres are listed: what the rows are, which figures follow x, y, z, r, and in which order.
struct SphereListing {
  std::vector<SphereFigure> columns{};
  SphereOrder order = SphereOrder::index;
  SphereRows rows = SphereRows::spheres;

  bool needs_contributions() const {
    return order == SphereOrder::contribution || std::ranges::any_of(columns, is_contribution);
  }
  /// Whether only simplified models have this.
  bool needs_levels() const { return rows != SphereRows::spheres || std::ranges::any_of(columns, is_of_levels); }
};

/// As what figures are asked for: their numbers, pixels, or shapes.
enum class FigureFormat : std::uint8_t { json, png, svg };
inline constexpr std::array figure_formats{FigureFormat::json, FigureFormat::png, FigureFormat::svg};

// What is made from a finished model, volume or registration and kept as the answer's bytes: a JSON document
// (json/documents.h), a picture, a file for other programs.

// From a model.

/// Measures and checks: JSON documents.
struct MeasuresRequest {};
struct ChecksRequest {};
/// A picture, or several.
struct RenderRequest {
  RenderOptions options{};
  std::string with{};  ///< a second model in the picture; empty: none
};
/// A table of spheres.
struct ExportRequest {
  SphereFormat format = SphereFormat::csv;
  SphereListing listing{};
};
/// Levels of a simplified model as a tree: a JSON document.
struct TreeRequest {
  std::vector<std::uint32_t> levels;  ///< ascending
};
/// A file for one other program.
struct FileRequest {
  FileFormat format = FileFormat::urdf;
  FileOptions options{};
};
/// Every sphere's part of the union: not sent as it is, but needed by measures and by listings of spheres.
struct ContributionsRequest {};

// From a volume.

/// A slice, as numbers or as a picture.
struct SliceRequest {
  int axis = 2;            ///< of the grid: 0, 1, 2 for i, j, k
  std::int32_t index = 0;  ///< of the slice along it
  std::optional<ObjectRule> object{};
  FigureFormat format = FigureFormat::png;
  SliceOptions options{};  ///< of a picture
};
/// Counts of its values: not sent as they are, but as a document or a plot.
struct ValuesRequest {
  std::size_t buckets = 256;
};

// From a registration.

/// A picture of both models, before and after.
struct BeforeAfterRequest {
  RenderOptions options{};
  bool few = false;  ///< of the k spheres instead of the models
};
/// The moving volume, or the moving model as a mask, on the grid of the fixed one's volume.
enum class Applied : std::uint8_t { volume, model };
struct AppliedRequest {
  Applied what = Applied::volume;
};

/// What is derived.
struct DerivedRequest {
  std::string source;  ///< id of the model, volume or registration
  std::variant<MeasuresRequest, ChecksRequest, RenderRequest, ExportRequest, ContributionsRequest, TreeRequest,
               FileRequest, SliceRequest, ValuesRequest, BeforeAfterRequest, AppliedRequest>
      what;
  std::uint32_t level = 0;  ///< of a simplified model, in place of its last; 0: that one
};

using WorkRequest = std::variant<ModelRequest, SimplificationRequest, RegistrationRequest, DerivedRequest>;

/// What is known of a kind of work beside how it is done (server/work/kinds.h).
struct Kind {
  std::string_view name;    ///< of its jobs, as users see it
  std::string_view record;  ///< in records: the same, but where one name is of several kinds
  std::string_view source;  ///< what it is made from: "volume", "model", "registration"; empty: as the request says
  int edition = 0;          ///< raised when its results change, so that none of old is served; 0: none was needed yet
};
const Kind& kind_of(const WorkRequest& request);

/// "csv", "npy", "ply", "vtp".
std::string_view name(SphereFormat format);
/// "index", "volume_mm3", …
std::string_view name(SphereFigure figure);
/// "spheres", "nodes", "members".
std::string_view name(SphereRows rows);
/// "index", "contribution".
std::string_view name(SphereOrder order);
/// "json", "png", "svg".
std::string_view name(FigureFormat format);
/// "volume", "model".
std::string_view name(Applied what);
std::string_view media_type(FigureFormat format);

/// Ids of the models, volumes and registrations that a request is for, each once.
std::vector<std::string> inputs_of(const WorkRequest& request);

}  // namespace spherule::api
