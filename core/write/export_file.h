// SPDX-License-Identifier: GPL-3.0-or-later
//
// Spheres -> a file for one other program, by name: which formats there are, what each may be asked for, and which
// measures and limits it needs. The writers are in export_bodies.h, export_scenes.h and export_grids.h.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/base/option_texts.h"
#include "core/inside.h"
#include "core/measure/union.h"
#include "core/spheres.h"
#include "core/volume.h"
#include "core/write/export_bodies.h"
#include "core/write/export_scenes.h"

namespace spherule {

enum class FileFormat : std::uint8_t { urdf, srdf, xrdf, curobo, liggghts, lammps, yade, xyz, pqr, glb, vdb, nifti };
inline constexpr std::size_t file_format_count = 12;

/// What is fixed for a format.
struct FileFormatInfo {
  std::string_view name;       ///< the enumerator's
  std::string_view extension;  ///< of file names, without the first dot
  std::string_view media_type;
  std::string_view unit;     ///< of lengths: "mm" or "m"
  std::string_view frame;    ///< where its axes point: LPS, RAS, or LSA (left, superior, anterior)
  std::size_t most_spheres;  ///< what its programs can bear; more is refused
};
const FileFormatInfo& info(FileFormat format);
std::optional<FileFormat> file_format(std::string_view name);

struct FileOptions {
  double density_kg_m3 = 1000;            ///< urdf, liggghts, lammps, yade; within ranges::density (base/ranges.h)
  std::string link = "object";            ///< urdf, srdf, xrdf, curobo: at most 64 letters, digits and underscores
  BodyOrigin origin = BodyOrigin::frame;  ///< bodies: all of these
  GlbOptions glb{};                       ///< as `style` and `detail`
  /// vdb: absent is 1/256 of the longest side of the spheres' box, but not below min_level_set_voxel_mm. nifti: the
  /// mask is on a grid of such voxels around the spheres, along LPS; absent: on the scan's own. Within
  /// ranges::voxel_mm.
  std::optional<double> voxel_mm{};
};

/// The names that a format's options have.
std::span<const std::string_view> file_option_names(FileFormat format);
/// Throws invalid_argument, with the name as pointer, for what is unknown to the format, given twice or out of bounds.
FileOptions parse_file_options(FileFormat format, const OptionTexts& given);
/// The options of the format that differ from the defaults; parsing them gives the options back.
OptionTexts file_option_texts(FileFormat format, const FileOptions& options);

/// What a file is made of.
struct FileSource {
  std::span<const Sphere> spheres;
  const Grid* scan = nullptr;            ///< what the model was made from, if known
  const SampleBits* inside = nullptr;    ///< of a raw model: the samples of the scan that its rule says are inside
  const UnionMeasures* whole = nullptr;  ///< of the spheres; needed where needs_union
};

/// Whether the file is a mask on the scan of a raw model, which takes FileSource::inside: samples that equal a
/// threshold lie on spheres, where rounding would decide.
bool mask_needs_samples(FileFormat format, const FileOptions& options, const SphereModel& model);
/// Whether the file holds mass properties, or is placed by them.
bool needs_union(FileFormat format);
/// Throws unusable for more spheres than the format's programs can bear, for none, and for a mask without a grid.
void check_exportable(FileFormat format, std::size_t spheres, bool has_scan, const FileOptions& options);
/// The bytes: the same ones for the same arguments. Throws what check_exportable and the writer throw.
std::string spheres_to_file(FileFormat format, const FileSource& source, const FileOptions& options,
                            const Context& context = {});

}  // namespace spherule
