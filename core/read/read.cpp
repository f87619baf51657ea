// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/read.h"

#include <algorithm>
#include <new>
#include <numbers>
#include <stdexcept>
#include <string_view>

#include "core/read/metaimage.h"
#include "core/read/nifti.h"
#include "core/read/nrrd.h"
#include "core/read/openvdb.h"
#include "core/read/raw.h"
#include "core/read/read_bytes.h"

namespace spherule {

namespace {

using Path = std::filesystem::path;

enum class Kind { unknown, damaged_gzip, nifti, analyze, nrrd, metaimage, openvdb, dicom, lfs_pointer };

// Enough for what programs write in front of a MetaImage header's own fields.
constexpr std::size_t kHead = std::size_t{1} << 16;

bool is_dicom(std::string_view head) {
  // Data sets without the preamble still name their class, by a UID of DICOM's own, near the start.
  head = head.substr(0, 4096);
  return (head.size() >= 132 && head.substr(128, 4) == "DICM") || head.find("1.2.840.10008.") != std::string_view::npos;
}

Kind kind_of(std::string_view head) {
  if (is_nifti(head)) return Kind::nifti;
  if (is_nrrd(head)) return Kind::nrrd;
  if (is_openvdb(head)) return Kind::openvdb;
  if (is_metaimage(head)) return Kind::metaimage;
  if (is_dicom(head)) return Kind::dicom;
  if (is_analyze(head)) return Kind::analyze;
  if (head.starts_with("version https://git-lfs")) return Kind::lfs_pointer;
  return Kind::unknown;
}

struct Sniffed {
  Kind kind = Kind::unknown;
  bool gzip = false;
  bool detached = false;  // a header that names its data in other files
};

Sniffed sniff(const Path& file) {
  const bool gzip = is_gzip(file);
  try {
    const std::string head = read_text(file, gzip ? Packing::deflate : Packing::none, kHead);
    return {kind_of(head), gzip, is_detached_nrrd(head) || is_detached_metaimage(head) || is_nifti_pair(head)};
  } catch (const Error& error) {
    if (error.code() == ErrorCode::malformed) return {.kind = Kind::damaged_gzip, .gzip = gzip};
    throw;
  }
}

bool has_reader(Kind kind) {
  return kind == Kind::nifti || kind == Kind::nrrd || kind == Kind::metaimage || kind == Kind::openvdb;
}

[[noreturn]] void refuse(Kind kind) {
  switch (kind) {
    case Kind::damaged_gzip:
      throw Error(ErrorCode::malformed, "The gzip stream is damaged or cut before any header; send the file again.");
    case Kind::analyze:
      throw Error(ErrorCode::unusable,
                  "The header is ANALYZE 7.5, which does not say left from right; convert the volume to NIfTI.");
    case Kind::dicom:
      throw Error(ErrorCode::unknown_format,
                  "DICOM is not read yet; convert the series to NIfTI, NRRD or MetaImage first.");
    case Kind::lfs_pointer:
      throw Error(ErrorCode::unknown_format,
                  "This is a git-LFS pointer, not the volume itself; fetch the file with git lfs pull and send that.");
    default:
      throw Error(ErrorCode::unknown_format,
                  "The format is not recognised; send NIfTI-1/2 (.nii, .nii.gz, .hdr + .img), NRRD, MetaImage or "
                  "OpenVDB, or describe headerless samples with format=raw, dims and dtype.");
  }
}

Volume dispatch(const std::vector<Path>& files, const ReadOptions& options, const Context& context) {
  if (options.raw) return read_raw(files, *options.raw, options, context);
  std::vector<Sniffed> sniffed;
  for (const Path& file : files) sniffed.push_back(sniff(file));
  const auto reads = [](const Sniffed& s) { return has_reader(s.kind); };
  auto found = std::ranges::find_if(sniffed, reads);
  if (found == sniffed.end()) {
    const auto known = std::ranges::find_if(sniffed, [](const Sniffed& s) { return s.kind != Kind::unknown; });
    refuse(known == sniffed.end() ? Kind::unknown : known->kind);
  }
  if (std::ranges::count_if(sniffed, reads) > 1) {
    // What a header says of its data comes before what their bytes look like.
    found = std::ranges::find_if(sniffed, &Sniffed::detached);
    if (std::ranges::count_if(sniffed, &Sniffed::detached) != 1) {
      throw Error(ErrorCode::unusable, "Several volumes were sent at once; send each by itself.");
    }
  }
  const Path& header = files[static_cast<std::size_t>(found - sniffed.begin())];
  if (found->kind == Kind::nifti) return read_nifti(header, files, options, context);
  if (found->gzip) {
    throw Error(ErrorCode::unknown_format,
                "Only NIfTI and raw files are read from within gzip; unpack this file and send it again.");
  }
  if (found->kind == Kind::nrrd) return read_nrrd(header, files, options, context);
  if (found->kind == Kind::metaimage) return read_metaimage(header, files, options, context);
  return read_openvdb(header, options, context);
}

// The smallest ball that reaches from one slice to the next, pi/6 a^3 for slices a apart, then takes more room than two
// voxels s t a along every axis.
bool has_thick_slices(const Grid& grid) {
  const int a = grid.spacing.x >= grid.spacing.y ? (grid.spacing.x >= grid.spacing.z ? 0 : 2)
                                                 : (grid.spacing.y >= grid.spacing.z ? 1 : 2);
  const double thick = grid.spacing[a], s = grid.spacing[(a + 1) % 3], t = grid.spacing[(a + 2) % 3];
  const bool solid = std::ranges::all_of(grid.dims, [](std::int32_t n) { return n > 1; });
  return solid && std::numbers::pi / 6 * thick * thick > 8 * s * t;
}

}  // namespace

Volume read_volume(const std::vector<Path>& files, const ReadOptions& options, const Context& context) {
  if (files.empty()) throw Error(ErrorCode::invalid_argument, "No file was sent; send the bytes of a volume.");
  for (const Path& file : files) {
    if (size_of_file(file) == 0) throw Error(ErrorCode::malformed, "A file that was sent is empty; send it again.");
  }
  try {
    Volume volume = dispatch(files, options, context);
    if (has_thick_slices(volume.grid)) {
      volume.warnings.emplace_back(
          "The samples lie far farther apart along one axis than along another (thick slices): spheres between two "
          "slices reach beyond the object; resample to nearly cubic voxels where its volume matters.");
    }
    if (volume.type == VoxelType::float32 || volume.type == VoxelType::float64) {
      if (const std::size_t count = value_range(volume, context).not_finite) {
        volume.warnings.push_back(std::to_string(count) + (count == 1 ? " voxel is" : " voxels are") +
                                  " not a finite number (NaN or infinite): outside of every object, with the surface "
                                  "half way to the next voxel.");
      }
    }
    return volume;
  } catch (const std::bad_alloc&) {
  } catch (const std::length_error&) {
  }
  throw Error(ErrorCode::too_large, "The volume needs more memory than there is; send a smaller or coarser one.");
}

}  // namespace spherule
