// SPDX-License-Identifier: GPL-3.0-or-later
//
// A cross-bilateral filter: neighbours count by nearness, by the angle between the normals and by the distance from
// the tangent plane. Single precision, in rows of eight, the eighth of weight 0: each column is summed by itself and
// the columns last, so the sums are the same on every processor.
#include "core/render/openness.h"

#include "core/base/vectors.h"

namespace spherule {
namespace {

constexpr int kSide = 2 * OpennessMap::reach + 1, kLanes = kSide + 1;
using Row = float __attribute__((vector_size(kLanes * sizeof(float))));
using Unaligned = float __attribute__((vector_size(kLanes * sizeof(float)), aligned(alignof(float)), may_alias));

// How much a neighbour counts by where it is; so little that it matters only where no neighbour is alike.
struct Falloff {
  std::array<Row, kSide> rows{}, any{};
  Falloff() {
    for (int v = 0; v < kSide; ++v)
      for (int u = 0; u < kSide; ++u) {
        const int x = u - OpennessMap::reach, y = v - OpennessMap::reach;
        rows[static_cast<std::size_t>(v)][u] = 1 / (1 + 0.12F * static_cast<float>(x * x + y * y));
        any[static_cast<std::size_t>(v)][u] = 1e-9F;
      }
  }
};
const Falloff kFalloff;

struct Arrays {
  const float *px, *py, *pz, *nx, *ny, *nz, *lamp, *sky, *lamp_known, *sky_known;
};

SPHERULE_VECTORS
Openness smoothed(const Arrays& a, std::size_t first, std::size_t stride, const std::array<float, 6>& place) {
  Row lamp{}, of_lamp{}, sky{}, of_sky{};
  for (std::size_t v = 0; v < kSide; ++v) {
    const std::size_t i = first + v * stride;
    const auto at = [i](const float* numbers) -> const Unaligned& {
      return *reinterpret_cast<const Unaligned*>(numbers + i);
    };
    const Row nx = at(a.nx), ny = at(a.ny), nz = at(a.nz);
    const Row dot = place[3] * nx + place[4] * ny + place[5] * nz;
    const Row off =
        place[3] * (at(a.px) - place[0]) + place[4] * (at(a.py) - place[1]) + place[5] * (at(a.pz) - place[2]);
    const Row alike = dot > 0 ? dot : Row{}, alike2 = alike * alike, alike4 = alike2 * alike2, apart = 1 + off * off;
    const Row weight = alike4 * alike4 / (apart * apart) * kFalloff.rows[v] + kFalloff.any[v];
    const Row to_lamp = weight * at(a.lamp_known), to_sky = weight * at(a.sky_known);
    lamp += to_lamp * at(a.lamp), of_lamp += to_lamp;
    sky += to_sky * at(a.sky), of_sky += to_sky;
  }
  const auto mean = [](const Row& sums, const Row& weights) {
    float sum = 0, weight = 0;
    for (int u = 0; u < kLanes; ++u) sum += sums[u], weight += weights[u];
    return weight > 0 ? static_cast<double>(sum / weight) : 1;
  };
  return {mean(lamp, of_lamp), mean(sky, of_sky)};
}

}  // namespace

void OpennessMap::reset(int width, int height) {
  stride_ = width + kLanes - 1;
  const std::size_t size = static_cast<std::size_t>(stride_) * static_cast<std::size_t>(height + kSide - 1) + 1;
  for (auto* numbers : {&px_, &py_, &pz_, &nx_, &ny_, &nz_, &lamp_, &sky_, &lamp_known_, &sky_known_})
    numbers->assign(size, 0);
}

void OpennessMap::place(int x, int y, Vec3 point, Vec3 normal) {
  const std::size_t i = offset(x, y);
  px_[i] = static_cast<float>(point.x), py_[i] = static_cast<float>(point.y), pz_[i] = static_cast<float>(point.z);
  nx_[i] = static_cast<float>(normal.x), ny_[i] = static_cast<float>(normal.y), nz_[i] = static_cast<float>(normal.z);
}
void OpennessMap::set_lamp(int x, int y, double open) {
  lamp_[offset(x, y)] = static_cast<float>(open), lamp_known_[offset(x, y)] = 1;
}
void OpennessMap::set_sky(int x, int y, double open) {
  sky_[offset(x, y)] = static_cast<float>(open), sky_known_[offset(x, y)] = 1;
}

Openness OpennessMap::at(int x, int y, Vec3 point, Vec3 normal) const {
  const std::array<float, 6> place{static_cast<float>(point.x),  static_cast<float>(point.y),
                                   static_cast<float>(point.z),  static_cast<float>(normal.x),
                                   static_cast<float>(normal.y), static_cast<float>(normal.z)};
  return smoothed({px_.data(), py_.data(), pz_.data(), nx_.data(), ny_.data(), nz_.data(), lamp_.data(), sky_.data(),
                   lamp_known_.data(), sky_known_.data()},
                  offset(x - reach, y - reach), static_cast<std::size_t>(stride_), place);
}

}  // namespace spherule
