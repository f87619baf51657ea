// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/listing.h"

#include <algorithm>
#include <string>
#include <utility>

#include "api/documents.h"

namespace spherule::server {

Contributions::Contributions(UnionMeasures whole)
    : volume(whole.moments.volume), parts(std::move(whole.parts)), ranking(rank_contributions(parts)) {}

double Contributions::value(api::SphereFigure figure, std::uint32_t sphere) const {
  using enum api::SphereFigure;
  switch (figure) {
    case index: return sphere;
    case volume_mm3: return parts[sphere].volume_mm3;
    case area_mm2: return parts[sphere].area_mm2;
    case share: return volume > 0 ? parts[sphere].volume_mm3 / volume : 0;
    case rank: return ranking.rank[sphere] + 1.0;
    case cumulative_share: break;
  }
  return ranking.cumulative[ranking.rank[sphere]];
}

api::SpherePage rows(const SphereModel& model, const Contributions* contributions, const api::SphereListing& listing,
                     std::uint64_t first, std::uint64_t count) {
  api::SpherePage page{.total = model.spheres.size(), .spheres = {}, .columns = {}};
  first = std::min(first, page.total);
  count = std::min(count, page.total - first);
  const auto sphere = [&](std::uint64_t row) {
    return listing.order == api::SphereOrder::index ? static_cast<std::uint32_t>(row)
                                                    : contributions->ranking.order[row];
  };
  page.spheres.reserve(count);
  for (std::uint64_t row = first; row < first + count; ++row) page.spheres.push_back(model.spheres[sphere(row)]);
  for (const api::SphereFigure figure : listing.columns) {
    SphereColumn& column = page.columns.emplace_back(SphereColumn{std::string(api::name(figure)), {}});
    column.values.reserve(count);
    for (std::uint64_t row = first; row < first + count; ++row) {
      column.values.push_back(contributions != nullptr ? contributions->value(figure, sphere(row)) : sphere(row));
    }
  }
  return page;
}

}  // namespace spherule::server
