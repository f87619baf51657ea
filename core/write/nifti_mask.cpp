// SPDX-License-Identifier: GPL-3.0-or-later
#include <zlib.h>

#include <array>
#include <new>

#include "core/base/check.h"
#include "core/write/export_grids.h"
#include "core/write/nifti_header.h"

namespace spherule {
namespace {

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
  Gzip gzip;
  gzip.add(nifti_header(grid, {.shown_up_to = 1, .description = "Spherule: samples in spheres"}));
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
