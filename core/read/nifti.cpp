// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/nifti.h"

#include <nifti2_io.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>

#include "core/read/read_bytes.h"
#include "core/read/read_header.h"

namespace spherule {

namespace {

constexpr std::size_t kHeader1 = sizeof(nifti_1_header);
constexpr std::size_t kHeader2 = sizeof(nifti_2_header);
static_assert(kHeader1 == 348 && kHeader2 == 540);

struct FreeImage {
  void operator()(nifti_image* image) const { nifti_image_free(image); }
};

std::int32_t swapped(std::int32_t v) {
  return static_cast<std::int32_t>(__builtin_bswap32(static_cast<std::uint32_t>(v)));
}

std::int32_t declared_size(std::string_view head) {
  std::int32_t size = 0;
  std::memcpy(&size, head.data(), sizeof size);
  return size;
}

bool has_size(std::string_view head, std::size_t size) {
  if (head.size() < 348) return false;
  const std::int32_t declared = declared_size(head);
  return declared == static_cast<std::int32_t>(size) || swapped(declared) == static_cast<std::int32_t>(size);
}

bool has_magic(std::string_view head, std::size_t at, char version) {
  return head[at] == 'n' && (head[at + 1] == '+' || head[at + 1] == 'i') && head[at + 2] == version;
}

bool is_version_2(std::string_view head) { return has_size(head, kHeader2) && has_magic(head, 4, '2'); }

// What matters of either version's header, wide enough for both.
struct Header {
  std::array<std::int64_t, 8> dim;
  std::array<double, 8> pixdim;
  double vox_offset, quatern[3], qoffset[3], slope, intercept;
  int datatype, qform_code, sform_code;
  bool pair, swapped;
  std::unique_ptr<nifti_image, FreeImage> image;
};

template <typename Raw>
Header widened(const Raw& raw) {
  Header h{};
  for (std::size_t i = 0; i < 8; ++i) h.dim[i] = raw.dim[i], h.pixdim[i] = static_cast<double>(raw.pixdim[i]);
  h.vox_offset = static_cast<double>(raw.vox_offset);
  h.quatern[0] = raw.quatern_b, h.quatern[1] = raw.quatern_c, h.quatern[2] = raw.quatern_d;
  h.qoffset[0] = raw.qoffset_x, h.qoffset[1] = raw.qoffset_y, h.qoffset[2] = raw.qoffset_z;
  h.slope = raw.scl_slope, h.intercept = raw.scl_inter;
  h.datatype = raw.datatype, h.qform_code = raw.qform_code, h.sform_code = raw.sform_code;
  h.pair = raw.magic[1] == 'i';
  return h;
}

VoxelType voxel_type_of(int datatype) {
  switch (datatype) {
    case DT_UINT8: return VoxelType::uint8;
    case DT_INT8: return VoxelType::int8;
    case DT_UINT16: return VoxelType::uint16;
    case DT_INT16: return VoxelType::int16;
    case DT_UINT32: return VoxelType::uint32;
    case DT_INT32: return VoxelType::int32;
    case DT_UINT64: return VoxelType::uint64;
    case DT_INT64: return VoxelType::int64;
    case DT_FLOAT32: return VoxelType::float32;
    case DT_FLOAT64: return VoxelType::float64;
    case DT_RGB24:
    case DT_RGBA32:
      throw Error(ErrorCode::unusable, "The file holds colours, not one scalar a voxel; convert it to a scalar type.");
    case DT_COMPLEX64:
    case DT_COMPLEX128:
    case DT_COMPLEX256:
      throw Error(ErrorCode::unusable,
                  "The file holds complex numbers, not one scalar a voxel; send the magnitude as a real type.");
    case DT_BINARY:
    case DT_FLOAT128:
      throw Error(ErrorCode::unusable,
                  "The file's samples are 1-bit or 128-bit; convert them to an 8- to 64-bit type.");
    default: throw Error(ErrorCode::malformed, "The NIfTI header's data type is unknown; correct the header.");
  }
}

// What libnifti2 mends without a word is mended before it sees it, in either version's header.
template <typename Raw>
void mend(Raw& raw, std::vector<std::string>& warnings) {
  using Size = std::remove_reference_t<decltype(raw.dim[0])>;
  bool sizes = false, steps = false;
  for (std::size_t i = 1; i < 8 && i <= static_cast<std::size_t>(std::max<Size>(raw.dim[0], 0)); ++i) {
    if (i > 3 && raw.dim[i] == 0) raw.dim[i] = 1, sizes = true;
    if (i <= 3 && raw.dim[i] == 1 && raw.pixdim[i] == 0) raw.pixdim[i] = 1, steps = true;
  }
  if (sizes) warnings.emplace_back("The NIfTI header has a size of 0 beyond its third dimension; it was taken as 1.");
  if (steps && raw.sform_code <= 0)
    warnings.emplace_back("The NIfTI header gives no spacing (pixdim 0) across its one slice; 1 was taken.");
}

// libnifti2 prints on some bad headers whatever its debug level: they are refused before it sees them.
void validate_sizes(const Header& h) {
  if (h.dim[0] < 1 || h.dim[0] > 7) {
    throw Error(ErrorCode::malformed, "The NIfTI header's number of dimensions is not within 1 and 7; correct it.");
  }
  for (std::size_t i = 1; i <= static_cast<std::size_t>(h.dim[0]); ++i) {
    if (h.dim[i] < 1) {
      throw Error(ErrorCode::unusable, "Every size in the NIfTI header must be at least 1; correct the header.");
    }
    if (i > 4 && h.dim[i] > 1) {
      throw Error(ErrorCode::unusable,
                  "The file holds vectors or more than four dimensions, not one scalar a voxel; split it first.");
    }
  }
}

// Of the qform and of pixdim alone.
void validate_steps(const Header& h) {
  for (std::size_t i = 1; i <= static_cast<std::size_t>(std::min<std::int64_t>(h.dim[0], 3)); ++i) {
    if (!std::isfinite(h.pixdim[i]) || !(h.pixdim[i] > 0)) {
      throw Error(ErrorCode::unusable,
                  "The spacing in the NIfTI header must be finite and above zero along every axis; correct pixdim.");
    }
  }
  const auto finite = [](double v) { return std::isfinite(v); };
  if (h.qform_code > 0 && !(std::ranges::all_of(h.quatern, finite) && std::ranges::all_of(h.qoffset, finite))) {
    throw Error(ErrorCode::unusable, "The NIfTI header's qform is not finite; correct the header.");
  }
}

Header parse(const std::string& head, std::vector<std::string>& warnings) {
  static const bool quiet = (nifti_set_debug_level(0), true);
  (void)quiet;
  const bool v2 = is_version_2(head);
  if (head.size() < (v2 ? kHeader2 : kHeader1)) {
    throw Error(ErrorCode::malformed, "The NIfTI header is cut; send the whole file.");
  }
  const bool swap = declared_size(head) != static_cast<std::int32_t>(v2 ? kHeader2 : kHeader1);
  const auto finish = [&](auto raw, auto swap_header, auto convert) {
    std::memcpy(&raw, head.data(), sizeof raw);
    auto native = raw;
    if (swap) swap_header(&native);
    mend(native, warnings);
    Header h = widened(native);
    h.swapped = swap;
    voxel_type_of(h.datatype);
    validate_sizes(h);
    if (h.sform_code <= 0) validate_steps(h);
    h.image.reset(convert(native, nullptr));
    if (!h.image) throw Error(ErrorCode::malformed, "The NIfTI header does not parse; send an intact file.");
    return h;
  };
  return v2 ? finish(nifti_2_header{}, nifti_swap_as_nifti2, nifti_convert_n2hdr2nim)
            : finish(nifti_1_header{}, nifti_swap_as_nifti1, nifti_convert_n1hdr2nim);
}

// By the table of units that all formats share.
std::string_view unit_name(int units) {
  switch (units) {
    case NIFTI_UNITS_UNKNOWN: return "";
    case NIFTI_UNITS_METER: return "m";
    case NIFTI_UNITS_MM: return "mm";
    case NIFTI_UNITS_MICRON: return "um";
    default: return "unknown";
  }
}

Grid grid_by(const Header& h, const nifti_dmat44& ras, double unit, std::array<std::int32_t, 3> dims) {
  Mat3 axes;
  Vec3 origin;
  for (int r = 0; r < 3; ++r) {
    const double sign = r < 2 ? -unit : unit;  // RAS to LPS
    for (int c = 0; c < 3; ++c) axes.rows[static_cast<std::size_t>(r)][c] = sign * ras.m[r][c] + 0.0;
    origin[r] = sign * ras.m[r][3] + 0.0;
  }
  // A flat picture may leave the step that it never takes empty.
  if (h.dim[0] < 3 && axes.column(2) == Vec3{}) {
    const Vec3 normal = cross(axes.column(0), axes.column(1));
    if (const double length = norm(normal); length > 0) {
      for (int r = 0; r < 3; ++r) axes.rows[static_cast<std::size_t>(r)][2] = normal[r] / length;
    }
  }
  return grid_from_affine(dims, axes, origin);
}

// Whether pixdim says something else about the steps of the grid than the affine did: by more than the 1e-3 by which
// angles may be off too, far beyond what rounding to float32 makes of a product of a rotation and a length.
bool steps_differ(const Header& h, const Grid& grid, double unit) {
  for (int a = 0; a < 3; ++a) {
    const double said = unit * std::abs(h.pixdim[static_cast<std::size_t>(a) + 1]);
    if (grid.dims[static_cast<std::size_t>(a)] == 1 || said == 0) continue;
    if (!(std::abs(said - grid.spacing[a]) <= 1e-3 * grid.spacing[a])) return true;
  }
  return false;
}

Grid grid_of(const Header& h, std::array<std::int32_t, 3> dims, std::vector<std::string>& warnings) {
  const double unit = millimetres_or_one(unit_name(h.image->xyz_units), warnings);
  if (h.sform_code > 0) {
    try {
      const Grid grid = grid_by(h, h.image->sto_xyz, unit, dims);
      if (steps_differ(h, grid, unit)) {
        warnings.push_back(
            "The NIfTI header's sform has other lengths than its pixdim; the sform was taken: if the volume comes out "
            "too large or too small, correct one of them.");
      }
      return grid;
    } catch (const Error&) {
      if (h.qform_code <= 0) throw;
      warnings.push_back(
          "The NIfTI header's sform cannot be used (it is empty, not finite, or not at right angles); the qform and "
          "pixdim were taken.");
    }
  }
  validate_steps(h);
  if (h.qform_code <= 0) {
    warnings.push_back(
        "The NIfTI header does not say how the volume lies in the patient; its axes were taken as right, anterior, "
        "superior.");
  }
  return grid_by(h, h.image->qto_xyz, unit, dims);
}

std::filesystem::path samples_file(const std::filesystem::path& header,
                                   const std::vector<std::filesystem::path>& files) {
  const auto stem = [](std::filesystem::path p) {
    if (p.extension() == ".gz") p = p.stem();
    return std::pair(p.stem().string(), p.extension().string());
  };
  std::vector<std::filesystem::path> others;
  for (const auto& file : files) {
    if (file == header) continue;
    if (stem(file) == std::pair(stem(header).first, std::string(".img"))) return file;
    others.push_back(file);
  }
  if (others.size() == 1) return others.front();
  throw Error(ErrorCode::malformed,
              "This NIfTI header keeps its samples in a second file (.img); send both files together.");
}

}  // namespace

bool is_nifti(std::string_view head) {
  return (has_size(head, kHeader1) && has_magic(head, 344, '1')) || is_version_2(head);
}

bool is_nifti_pair(std::string_view head) { return is_nifti(head) && head[is_version_2(head) ? 5 : 345] == 'i'; }

bool is_analyze(std::string_view head) { return has_size(head, kHeader1) && head[38] == 'r' && !is_nifti(head); }

Volume read_nifti(const std::filesystem::path& header, const std::vector<std::filesystem::path>& files,
                  const ReadOptions& options, const Context& context) {
  const std::string head = read_text(header, is_gzip(header) ? Packing::deflate : Packing::none, kHeader2);
  Volume volume;
  const Header h = parse(head, volume.warnings);
  const std::size_t rank = static_cast<std::size_t>(h.dim[0]);
  const auto size = [&](std::size_t i) { return i <= rank ? h.dim[i] : std::int64_t{1}; };

  volume.format = "nifti";
  volume.type = voxel_type_of(h.datatype);
  const auto dims = checked_dims({size(1), size(2), size(3)}, volume.type, options.limits);
  const std::int64_t frame = chosen_frame(size(4), options);
  volume.grid = grid_of(h, dims, volume.warnings);
  if (h.slope != 0 && !std::isnan(h.slope)) {
    // Then no stored integer, of 64 bits at most, becomes an infinite value.
    constexpr double kLargest = 1e280;
    if (!(std::abs(h.slope) <= kLargest && std::abs(h.intercept) <= kLargest)) {
      throw Error(ErrorCode::unusable,
                  "The NIfTI header's slope or intercept is not finite, or beyond 1e280; correct the header.");
    }
    volume.slope = h.slope, volume.intercept = h.intercept;
  }

  const double first = h.pair ? 0 : static_cast<double>(is_version_2(head) ? kHeader2 : kHeader1);
  // Some writers leave 0 for "right after the header" (and its four bytes of extension flags).
  const double offset = !h.pair && h.vox_offset == 0 ? first + 4 : h.vox_offset;
  if (!std::isfinite(offset) || offset < first || offset != std::floor(offset)) {
    throw Error(ErrorCode::malformed, "The NIfTI header's offset of the samples is not possible; correct vox_offset.");
  }
  if (offset > static_cast<double>(options.limits.max_header_bytes)) {
    throw Error(ErrorCode::too_large, "The NIfTI header's extensions are larger than allowed; remove them.");
  }
  SampleSource source;
  source.files = {h.pair ? samples_file(header, files) : header};
  // Samples of the right size are what the header says, whatever their first bytes look like.
  const std::uint64_t wanted = volume.grid.sample_count() * bytes_per_voxel(volume.type) *
                               static_cast<std::uint64_t>(std::min(size(4), std::int64_t{1} << 20));
  const bool exact = h.pair && size_of_file(source.files[0]) == wanted + static_cast<std::uint64_t>(offset);
  source.packing = !exact && is_gzip(source.files[0]) ? Packing::deflate : Packing::none;
  source.skip = static_cast<std::uint64_t>(offset);
  source.big_endian = h.swapped == (std::endian::native == std::endian::little);
  source.frames = size(4);
  source.frame = frame;
  read_samples(volume, source, context);
  return volume;
}

}  // namespace spherule
