// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/io/write_nifti.h"

#include <array>
#include <cmath>
#include <cstring>

namespace spherule {

namespace {

constexpr std::size_t kHeader = 348, kOffset = 352;

// The format's codes, in the order of VoxelType.
constexpr std::array<std::int16_t, 10> kCodes = {2, 256, 512, 4, 768, 8, 1280, 1024, 16, 64};

class HeaderBytes {
 public:
  HeaderBytes() : bytes(kOffset, '\0') {}
  template <typename T>
  void put(std::size_t offset, T value) {
    std::memcpy(&bytes[offset], &value, sizeof value);
  }
  void put(std::size_t offset, double value) = delete;  // fields are float32
  std::string bytes;
};

// The quaternion (b, c, d) of a rotation, with a >= 0: as nifti1.h says.
std::array<double, 3> quaternion_of(const Mat3& m) {
  const double xx = m.rows[0].x, yy = m.rows[1].y, zz = m.rows[2].z;
  const auto half_root = [](double s) { return 0.5 * std::sqrt(std::max(s, 0.0)); };
  std::array<double, 3> q{std::copysign(half_root(1 + xx - yy - zz), m.rows[2].y - m.rows[1].z),
                          std::copysign(half_root(1 - xx + yy - zz), m.rows[0].z - m.rows[2].x),
                          std::copysign(half_root(1 - xx - yy + zz), m.rows[1].x - m.rows[0].y)};
  if (1 + xx + yy + zz > 1e-9) return q;
  // A half turn: the signs follow from the products instead.
  const std::size_t first = q[0] != 0 ? 0 : 1;
  q[0] = std::abs(q[0]), q[1] = std::abs(q[1]), q[2] = std::abs(q[2]);
  const std::array<double, 3> products{m.rows[0].y, m.rows[0].z, m.rows[1].z};
  if (first == 0) {
    q[1] = std::copysign(q[1], products[0]);
    q[2] = std::copysign(q[2], products[1]);
  } else {
    q[2] = std::copysign(q[2], products[2]);
  }
  return q;
}

}  // namespace

std::string volume_to_nifti(const Volume& volume) {
  const Grid& grid = volume.grid;
  HeaderBytes header;
  const auto real = [&](std::size_t offset, double value) { header.put(offset, static_cast<float>(value)); };
  header.put(0, std::int32_t{kHeader});
  header.put(40, std::int16_t{3});
  for (std::size_t a = 0; a < 3; ++a) {
    if (grid.dims[a] > 32767) {
      throw Error(ErrorCode::too_large, "A NIfTI-1 file has at most 32767 samples along an axis; use a smaller grid.");
    }
    header.put(42 + 2 * a, static_cast<std::int16_t>(grid.dims[a]));
  }
  for (std::size_t d = 3; d < 7; ++d) header.put(42 + 2 * d, std::int16_t{1});
  header.put(70, kCodes[static_cast<std::size_t>(volume.type)]);
  header.put(72, static_cast<std::int16_t>(8 * bytes_per_voxel(volume.type)));

  // LPS to RAS turns the signs of the first two rows; a left-handed grid is a right-handed one with its last axis
  // reversed, which qfac says.
  Mat3 axes = grid.direction;
  Vec3 origin = grid.origin;
  for (std::size_t r = 0; r < 2; ++r) {
    axes.rows[r] = -axes.rows[r];
    origin[static_cast<int>(r)] = -origin[static_cast<int>(r)];
  }
  const bool left_handed = determinant(axes) < 0;
  Mat3 turn = axes;
  if (left_handed)
    for (Vec3& row : turn.rows) row.z = -row.z;
  real(76, left_handed ? -1 : 1);
  for (int a = 0; a < 3; ++a) real(80 + 4 * static_cast<std::size_t>(a), grid.spacing[a]);
  for (std::size_t d = 3; d < 7; ++d) real(80 + 4 * d, 1);
  real(108, kOffset);
  real(112, volume.slope);
  real(116, volume.intercept);
  header.put(123, std::uint8_t{2});  // mm
  header.put(252, std::int16_t{1});  // scanner coordinates, qform and sform
  header.put(254, std::int16_t{1});
  const std::array<double, 3> q = quaternion_of(turn);
  for (std::size_t a = 0; a < 3; ++a) {
    real(256 + 4 * a, q[a]);
    real(268 + 4 * a, origin[static_cast<int>(a)]);
    for (int c = 0; c < 3; ++c) real(280 + 16 * a + 4 * static_cast<std::size_t>(c), axes.rows[a][c] * grid.spacing[c]);
    real(280 + 16 * a + 12, origin[static_cast<int>(a)]);
  }
  header.bytes.replace(344, 3, "n+1");
  header.bytes.append(reinterpret_cast<const char*>(volume.voxels.data()), volume.voxels.size());
  return std::move(header.bytes);
}

}  // namespace spherule
