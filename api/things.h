// SPDX-License-Identifier: GPL-3.0-or-later
//
// What is kept, as the interface tells of it: volumes, models and registrations, each under an id of its own.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <variant>
#include <vector>

#include "api/jobs.h"
#include "api/work.h"
#include "core/base/geometry.h"
#include "core/measure/solid.h"
#include "core/read/read.h"
#include "core/volume.h"

namespace spherule::api {

/// A page of a list: the entries after `cursor` (opaque, from the page before; empty: from the newest).
struct PageRequest {
  std::size_t limit = 100;
  std::string cursor;
};
template <typename T>
struct Page {
  std::vector<T> items;
  std::string next;                    ///< cursor of the following page; empty on the last one
  std::vector<std::string> damaged{};  ///< ids of entries of this page whose records cannot be read
};

// ---------------------------------------------------------------------------------------------------------- volumes

/// What a user says about the bytes, beyond the bytes: part of the volume's identity.
struct VolumeParameters {
  std::optional<RawLayout> raw;
  std::optional<int> frame;
  std::string grid;
};

struct StoredFile {
  std::string name;  ///< plain; only one of several files has one. Never shown: it may name a patient
  std::string sha256;
  std::uint64_t bytes = 0;
};

struct VolumeInfo {
  std::string id;
  Time created;
  std::vector<StoredFile> files;  ///< ascending by name
  VolumeParameters parameters;
  std::string format;
  Grid grid;
  VoxelType type = VoxelType::uint8;
  double slope = 1, intercept = 0;
  ValueRange range;
  Side natural_side = Side::above;
  std::vector<std::string> warnings;

  std::uint64_t bytes() const;  ///< of all files
};

// ----------------------------------------------------------------------------------------------------------- models

/// How a simplified model came to be, and how near it is to its object: the scan's where its chain of source models
/// begins with one, else the union of the spheres that were imported.
struct SimplificationInfo {
  SimplificationRequest request;
  std::uint32_t levels = 0;  ///< level k shows at most k spheres; the last is the model itself
  std::uint64_t nodes = 0;   ///< spheres of all levels together
  Achieved achieved;
  std::optional<double> optimality_gap;  ///< as of BestSpheres
  double seconds = 0;                    ///< that the method took
};

struct ModelInfo {
  std::string id;
  Time created;
  std::string algorithm_version;
  // Exactly one of these three is there.
  std::optional<ModelRequest> source;
  std::optional<SimplificationInfo> simplification;
  std::string imported_format;  ///< "csv" or "npy"
  std::uint64_t boundary_points = 0;
  std::uint64_t tetrahedra = 0, inside_tetrahedra = 0;  ///< all finite cells of the tetrahedralization; those inside
  std::uint64_t spheres = 0;
  double boundary_point_density_mm = 0;
  std::optional<VoxelMeasures> voxels;  ///< of the inside samples; raw models only
  Box bounds;
  std::map<std::string, double> timings_s;  ///< by stage
  std::vector<std::string> warnings;
};

// ---------------------------------------------------------------------------------------------------- registrations

struct RegistrationInfo {
  std::string id;
  RegistrationRequest request;
  AffineMap moving_to_fixed;
  std::vector<Sphere> fixed_spheres, moving_spheres;  ///< the k spheres of each
  std::string document;                               ///< what users see (json/registration_documents.h)
};

// ------------------------------------------------------------------------------------------------------ each of these

/// In the order of Collection.
using Thing = std::variant<VolumeInfo, ModelInfo, RegistrationInfo>;
enum class Collection : std::uint8_t { volumes, models, registrations };
inline constexpr std::array collections{Collection::volumes, Collection::models, Collection::registrations};
template <typename T>
constexpr Collection collection_of = std::is_same_v<T, VolumeInfo>  ? Collection::volumes
                                     : std::is_same_v<T, ModelInfo> ? Collection::models
                                                                    : Collection::registrations;
/// "volumes", "models", "registrations".
std::string_view name(Collection collection);

}  // namespace spherule::api
