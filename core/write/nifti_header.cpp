// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/write/nifti_header.h"

#include <nifti2_io.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <memory>
#include <new>

#include "core/base/check.h"

namespace spherule {
namespace {

struct FreeImage {
  void operator()(nifti_image* image) const { nifti_image_free(image); }
};
using Image = std::unique_ptr<nifti_image, FreeImage>;

// The format's codes, in the order of VoxelType.
constexpr std::array<int, 10> kCodes = {DT_UINT8, DT_INT8,   DT_UINT16, DT_INT16,   DT_UINT32,
                                        DT_INT32, DT_UINT64, DT_INT64,  DT_FLOAT32, DT_FLOAT64};

// From sample indices.
nifti_dmat44 ras_of(const Grid& grid) {
  nifti_dmat44 ras{};
  for (int r = 0; r < 3; ++r) {
    const double sign = r < 2 ? -1 : 1;  // LPS to RAS
    const Vec3 row = grid.direction.rows[static_cast<std::size_t>(r)];
    for (int c = 0; c < 3; ++c) ras.m[r][c] = sign * row[c] * grid.spacing[c] + 0.0;
    ras.m[r][3] = sign * grid.origin[r] + 0.0;
  }
  ras.m[3][3] = 1;
  return ras;
}

// How far float32 moves a corner along an axis of the frame, at most.
double shift_of(const Grid& grid, const nifti_dmat44& ras) {
  double most = 0;
  for (int r = 0; r < 3; ++r) {
    double shift = std::abs(ras.m[r][3] - static_cast<float>(ras.m[r][3]));
    for (int c = 0; c < 3; ++c) {
      shift += std::abs(ras.m[r][c] - static_cast<float>(ras.m[r][c])) * (grid.dims[static_cast<std::size_t>(c)] - 1);
    }
    most = std::max(most, shift);
  }
  return most;
}

Image image_of(const Grid& grid, const nifti_dmat44& ras, const NiftiSamples& samples) {
  Image image(nifti_simple_init_nim());
  if (!image) throw std::bad_alloc();
  image->ndim = 3;
  image->nx = grid.dims[0], image->ny = grid.dims[1], image->nz = grid.dims[2];
  image->nvox = static_cast<std::int64_t>(grid.sample_count());
  image->dx = grid.spacing.x, image->dy = grid.spacing.y, image->dz = grid.spacing.z;
  image->datatype = kCodes[static_cast<std::size_t>(samples.type)];
  image->nbyper = static_cast<int>(bytes_per_voxel(samples.type));
  image->xyz_units = NIFTI_UNITS_MM;
  image->scl_slope = samples.slope;
  image->scl_inter = samples.intercept;
  image->cal_max = samples.shown_up_to;
  image->qform_code = image->sform_code = NIFTI_XFORM_SCANNER_ANAT;
  image->sto_xyz = ras;
  nifti_dmat44_to_quatern(ras, &image->quatern_b, &image->quatern_c, &image->quatern_d, &image->qoffset_x,
                          &image->qoffset_y, &image->qoffset_z, nullptr, nullptr, nullptr, &image->qfac);
  return image;
}

template <typename Header>
std::string bytes_of(Header header, std::string_view magic, const std::string& description) {
  constexpr std::size_t no_extensions = 4;
  std::memcpy(header.magic, magic.data(), magic.size());
  header.vox_offset = sizeof header + no_extensions;
  std::memset(header.descrip, 0, sizeof header.descrip);
  description.copy(header.descrip, sizeof header.descrip - 1);
  std::string bytes(sizeof header + no_extensions, '\0');
  std::memcpy(bytes.data(), &header, sizeof header);
  return bytes;
}

}  // namespace

std::string nifti_header(const Grid& grid, const NiftiSamples& samples) {
  const nifti_dmat44 ras = ras_of(grid);
  const Image image = image_of(grid, ras, samples);
  const double least_step = std::min({grid.spacing.x, grid.spacing.y, grid.spacing.z});
  if (*std::ranges::max_element(grid.dims) > INT16_MAX || !(shift_of(grid, ras) <= max_nifti_1_shift * least_step)) {
    image->nifti_type = NIFTI_FTYPE_NIFTI2_1;
    nifti_2_header header{};
    SPHERULE_CHECK(nifti_convert_nim2n2hdr(image.get(), &header) == 0);
    return bytes_of(header, std::string_view("n+2\0\r\n\032\n", 8), samples.description);
  }
  image->nifti_type = NIFTI_FTYPE_NIFTI1_1;
  nifti_1_header header{};
  SPHERULE_CHECK(nifti_convert_nim2n1hdr(image.get(), &header) == 0);
  return bytes_of(header, std::string_view("n+1\0", 4), samples.description);
}

}  // namespace spherule
