// SPDX-License-Identifier: GPL-3.0-or-later
#include <nifti2_io.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <memory>
#include <new>

#include "core/base/check.h"
#include "core/base/error.h"
#include "core/io/export_grids.h"

namespace spherule {
namespace {

struct FreeImage {
  void operator()(nifti_image* image) const { nifti_image_free(image); }
};

nifti_1_header header_of(const Grid& grid) {
  const std::unique_ptr<nifti_image, FreeImage> image(nifti_simple_init_nim());
  if (!image) throw std::bad_alloc();
  image->ndim = 3;
  image->nx = grid.dims[0], image->ny = grid.dims[1], image->nz = grid.dims[2];
  image->nvox = static_cast<std::int64_t>(grid.sample_count());
  image->dx = grid.spacing.x, image->dy = grid.spacing.y, image->dz = grid.spacing.z;
  image->datatype = DT_UINT8, image->nbyper = 1;
  image->nifti_type = NIFTI_FTYPE_NIFTI1_1;
  image->xyz_units = NIFTI_UNITS_MM;
  image->scl_slope = 1;
  image->cal_max = 1;
  image->qform_code = image->sform_code = NIFTI_XFORM_SCANNER_ANAT;
  nifti_dmat44 ras{};
  for (int r = 0; r < 3; ++r) {
    const double sign = r < 2 ? -1 : 1;  // LPS to RAS
    const Vec3 row = grid.direction.rows[static_cast<std::size_t>(r)];
    for (int c = 0; c < 3; ++c) ras.m[r][c] = sign * row[c] * grid.spacing[c] + 0.0;
    ras.m[r][3] = sign * grid.origin[r] + 0.0;
  }
  ras.m[3][3] = 1;
  image->sto_xyz = ras;
  nifti_dmat44_to_quatern(ras, &image->quatern_b, &image->quatern_c, &image->quatern_d, &image->qoffset_x,
                          &image->qoffset_y, &image->qoffset_z, nullptr, nullptr, nullptr, &image->qfac);
  nifti_1_header header{};
  SPHERULE_CHECK(nifti_convert_nim2n1hdr(image.get(), &header) == 0);
  std::memcpy(header.magic, "n+1", 4);
  header.vox_offset = 352;
  std::memset(header.descrip, 0, sizeof header.descrip);
  std::strncpy(header.descrip, "Spherule: samples in spheres", sizeof header.descrip - 1);
  return header;
}

// Deflates what is given in pieces, with a header that names no file and no time.
class Gzip {
 public:
  Gzip() {
    if (deflateInit2(&stream_, 6, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY) != Z_OK) throw std::bad_alloc();
  }
  ~Gzip() { deflateEnd(&stream_); }
  Gzip(const Gzip&) = delete;
  Gzip& operator=(const Gzip&) = delete;

  void add(std::string_view bytes, bool last = false) {
    stream_.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
    stream_.avail_in = static_cast<uInt>(bytes.size());
    std::array<char, 1 << 16> room;
    do {
      stream_.next_out = reinterpret_cast<Bytef*>(room.data());
      stream_.avail_out = static_cast<uInt>(room.size());
      deflate(&stream_, last ? Z_FINISH : Z_NO_FLUSH);
      out_.append(room.data(), room.size() - stream_.avail_out);
    } while (stream_.avail_out == 0);
  }
  std::string finish() {
    add({}, true);
    return std::move(out_);
  }

 private:
  z_stream stream_{};
  std::string out_;
};

}  // namespace

std::string mask_to_nifti(const Grid& grid, const SampleBits& mask) {
  SPHERULE_CHECK(mask.dims() == grid.dims);
  if (*std::ranges::max_element(grid.dims) > 32767) {
    throw Error(ErrorCode::unusable, "NIfTI-1 has at most 32767 samples along an axis; ask for a larger voxel_mm.");
  }
  const nifti_1_header header = header_of(grid);
  Gzip gzip;
  gzip.add({reinterpret_cast<const char*>(&header), sizeof header});
  gzip.add(std::string_view("\0\0\0\0", 4));  // no extensions
  std::string row(static_cast<std::size_t>(grid.dims[0]), '\0');
  for (std::int32_t k = 0; k < grid.dims[2]; ++k) {
    for (std::int32_t j = 0; j < grid.dims[1]; ++j) {
      for (std::int32_t i = 0; i < grid.dims[0]; ++i) {
        row[static_cast<std::size_t>(i)] = mask.test(i, j, k) ? '\1' : '\0';
      }
      gzip.add(row);
    }
  }
  return gzip.finish();
}

}  // namespace spherule
