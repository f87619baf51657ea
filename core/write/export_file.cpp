// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/write/export_file.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/base/check.h"
#include "core/base/error.h"
#include "core/base/option_values.h"
#include "core/base/ranges.h"
#include "core/base/text.h"
#include "core/sampled/object.h"
#include "core/write/export_grids.h"

namespace spherule {
namespace {

constexpr std::size_t kAny = std::size_t{1} << 40;
constexpr std::size_t kMostSamples = std::size_t{1} << 29;

// In the order of FileFormat.
constexpr auto kFormats = std::to_array<FileFormatInfo>({
    {"urdf", "urdf", "application/xml", "m", "LPS", 10'000},
    {"srdf", "srdf", "application/xml", "m", "LPS", 10'000},
    {"xrdf", "xrdf", "application/yaml", "m", "LPS", 10'000},
    {"curobo", "yml", "application/yaml", "m", "LPS", 10'000},
    {"liggghts", "multisphere", "text/plain", "m", "LPS", 100'000},
    {"lammps", "molecule", "text/plain", "m", "LPS", 100'000},
    {"yade", "clump.txt", "text/plain", "m", "LPS", 100'000},
    {"xyz", "xyz", "chemical/x-xyz", "mm", "LPS", kAny},
    {"pqr", "pqr", "chemical/x-pqr", "mm", "LPS", 99'999},
    {"glb", "glb", "model/gltf-binary", "m", "LSA", 10'000'000},
    {"vdb", "vdb", "application/x-openvdb", "mm", "LPS", kAny},
    {"nifti", "nii.gz", "application/gzip", "mm", "RAS", kAny},
});
static_assert(kFormats.size() == file_format_count);

bool is_body(FileFormat format) { return format <= FileFormat::yade; }
bool has_link(FileFormat format) { return format <= FileFormat::curobo; }

constexpr std::array<std::string_view, 3> kUrdf = {"density", "link", "origin"};
constexpr std::array<std::string_view, 2> kLinks = {"link", "origin"}, kClumps = {"density", "origin"},
                                          kGlb = {"style", "detail"};
constexpr std::array<std::string_view, 1> kGrids = {"voxel_mm"};

double number_within(const ranges::Real& range, std::string_view name, std::string_view text) {
  const auto value = number_in<double>(text);
  if (!value || !range.holds(*value)) detail::refuse_option(name, "Give a number " + range.words() + ".");
  return *value;
}

bool is_name(std::string_view text) {
  const auto letter = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; };
  const auto in_name = [&](char c) { return letter(c) || (c >= '0' && c <= '9'); };
  return !text.empty() && text.size() <= 64 && letter(text.front()) && std::ranges::all_of(text, in_name);
}

// One of two words; whether it is the second.
bool second_of(std::string_view name, std::string_view text, std::string_view first, std::string_view second) {
  if (text != first && text != second) {
    detail::refuse_option(name, "Give " + std::string(first) + " or " + std::string(second) + ".");
  }
  return text == second;
}

void set(FileOptions& options, std::string_view name, std::string_view text) {
  if (name == "density") {
    options.density_kg_m3 = number_within(ranges::density, name, text);
  } else if (name == "link") {
    if (!is_name(text)) {
      detail::refuse_option(name, "Give a letter or underscore and then at most 63 letters, digits and underscores.");
    }
    options.link = text;
  } else if (name == "origin") {
    options.origin = second_of(name, text, "frame", "centre") ? BodyOrigin::centre : BodyOrigin::frame;
  } else if (name == "style") {
    options.glb.style =
        second_of(name, text, "instanced", "mesh") ? GlbOptions::Style::mesh : GlbOptions::Style::instanced;
  } else if (name == "detail") {
    const auto value = number_in<int>(text);
    if (!value || !ranges::detail.holds(*value))
      detail::refuse_option(name, "Give a whole number " + ranges::detail.words() + ".");
    options.glb.detail = *value;
  } else {
    options.voxel_mm = number_within(ranges::voxel_mm, name, text);
  }
}

std::string value_of(const FileOptions& options, std::string_view name) {
  if (name == "density") return text_of(options.density_kg_m3);
  if (name == "link") return options.link;
  if (name == "origin") return options.origin == BodyOrigin::frame ? "frame" : "centre";
  if (name == "style") return options.glb.style == GlbOptions::Style::instanced ? "instanced" : "mesh";
  if (name == "detail") return text_of(options.glb.detail);
  return options.voxel_mm ? text_of(*options.voxel_mm) : "";
}

Box box_of(std::span<const Sphere> spheres) {
  Box box;
  for (const Sphere& s : spheres) box.include(s);
  return box;
}

// Voxels of a given size around the spheres, along the axes of the frame, with a layer of others around.
Grid grid_around(std::span<const Sphere> spheres, double voxel_mm) {
  const Box box = box_of(spheres);
  Grid grid;
  grid.spacing = {voxel_mm, voxel_mm, voxel_mm};
  grid.origin = box.min - Vec3{voxel_mm, voxel_mm, voxel_mm};
  double samples = 1;
  for (int a = 0; a < 3; ++a) {
    const double size = std::floor((box.max[a] - box.min[a]) / voxel_mm) + 4;
    samples *= size;
    if (samples > static_cast<double>(kMostSamples)) {
      throw Error(ErrorCode::too_large, "The mask would have too many voxels; ask for a larger voxel_mm.");
    }
    grid.dims[static_cast<std::size_t>(a)] = static_cast<std::int32_t>(size);
  }
  return grid;
}

std::string body_file(FileFormat format, const FileSource& source, const FileOptions& options) {
  SPHERULE_CHECK(source.whole != nullptr);
  const RigidBody body = rigid_body(source.spheres, *source.whole, options.density_kg_m3, options.origin);
  switch (format) {
    case FileFormat::urdf: return body_to_urdf(body, options.link);
    case FileFormat::srdf: return body_to_srdf(body, options.link);
    case FileFormat::xrdf: return body_to_xrdf(body, options.link);
    case FileFormat::curobo: return body_to_curobo(body, options.link);
    case FileFormat::liggghts: return body_to_liggghts(body);
    case FileFormat::lammps: return body_to_lammps(body);
    default: return body_to_yade(body);
  }
}

}  // namespace

const FileFormatInfo& info(FileFormat format) { return kFormats[static_cast<std::size_t>(format)]; }

std::optional<FileFormat> file_format(std::string_view name) {
  const auto found = std::ranges::find(kFormats, name, &FileFormatInfo::name);
  if (found == kFormats.end()) return std::nullopt;
  return static_cast<FileFormat>(found - kFormats.begin());
}

std::span<const std::string_view> file_option_names(FileFormat format) {
  if (format == FileFormat::urdf) return kUrdf;
  if (has_link(format)) return kLinks;
  if (is_body(format)) return kClumps;
  if (format == FileFormat::glb) return kGlb;
  if (format == FileFormat::vdb || format == FileFormat::nifti) return kGrids;
  return {};
}

FileOptions parse_file_options(FileFormat format, const OptionTexts& given) {
  const auto names = file_option_names(format);
  FileOptions options;
  for (auto it = given.begin(); it != given.end(); ++it) {
    const auto& [name, text] = *it;
    if (std::ranges::find(names, name) == names.end()) {
      std::string known;
      for (const std::string_view n : names) known += (known.empty() ? "" : ", ") + std::string(n);
      detail::refuse_option(name.substr(0, 100), std::string(info(format).name) + " has " +
                                                     (known.empty() ? "no options." : "the options " + known + "."));
    }
    if (std::any_of(given.begin(), it, [&](const auto& other) { return other.first == name; })) {
      detail::refuse_option(name, "Give this option once.");
    }
    set(options, name, text);
  }
  return options;
}

OptionTexts file_option_texts(FileFormat format, const FileOptions& options) {
  OptionTexts texts;
  for (const std::string_view name : file_option_names(format)) {
    if (std::string text = value_of(options, name); text != value_of({}, name))
      texts.emplace_back(name, std::move(text));
  }
  return texts;
}

bool mask_needs_samples(FileFormat format, const FileOptions& options, const SphereModel& model) {
  return format == FileFormat::nifti && !options.voxel_mm && model.solid;
}

bool needs_union(FileFormat format) { return is_body(format); }

void check_exportable(FileFormat format, std::size_t spheres, bool has_scan, const FileOptions& options) {
  const FileFormatInfo& about = info(format);
  if (spheres == 0) throw Error(ErrorCode::unusable, "The model has no spheres to write.");
  if (spheres > about.most_spheres) {
    throw Error(ErrorCode::unusable, "A file of format " + std::string(about.name) + " can have at most " +
                                         std::to_string(about.most_spheres) +
                                         " spheres to be of use; simplify the model first.");
  }
  if (format == FileFormat::nifti && !options.voxel_mm && !has_scan) {
    throw Error(ErrorCode::unusable,
                "This model was not made from a scan, so it has no grid of its own; give voxel_mm, the size of the "
                "mask's voxels.");
  }
}

std::string spheres_to_file(FileFormat format, const FileSource& source, const FileOptions& options,
                            const Context& context) {
  check_exportable(format, source.spheres.size(), source.scan != nullptr, options);
  switch (format) {
    case FileFormat::xyz: return spheres_to_xyz(source.spheres);
    case FileFormat::pqr: return spheres_to_pqr(source.spheres);
    case FileFormat::glb: return spheres_to_glb(source.spheres, options.glb, context);
    case FileFormat::vdb: {
      const Box box = box_of(source.spheres);
      const Vec3 size = box.max - box.min;
      const double longest = std::max({size.x, size.y, size.z});
      return spheres_to_vdb(
          source.spheres, options.voxel_mm.value_or(longest > 0 ? std::max(longest / 256, min_level_set_voxel_mm) : 1),
          max_level_set_blocks, context);
    }
    case FileFormat::nifti: {
      if (!options.voxel_mm && source.inside != nullptr) return mask_to_nifti(*source.scan, *source.inside);
      const Grid grid = options.voxel_mm ? grid_around(source.spheres, *options.voxel_mm) : *source.scan;
      return mask_to_nifti(grid, sample_union(source.spheres, grid, context).inside);
    }
    default: return body_file(format, source, options);
  }
}

}  // namespace spherule
