// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/records/listing.h"

#include <algorithm>
#include <string>
#include <utility>

#include "api/json/documents.h"

namespace spherule::server {

Contributions::Contributions(UnionMeasures whole)
    : volume(whole.moments.volume), parts(std::move(whole.parts)), ranking(rank_contributions(parts)) {}

double Contributions::value(api::SphereFigure figure, std::uint32_t sphere) const {
  using enum api::SphereFigure;
  switch (figure) {
    case volume_mm3: return parts[sphere].volume_mm3;
    case area_mm2: return parts[sphere].area_mm2;
    case share: return volume > 0 ? parts[sphere].volume_mm3 / volume : 0;
    case rank: return ranking.rank[sphere] + 1.0;
    default: break;
  }
  return ranking.cumulative[ranking.rank[sphere]];
}

namespace {

// How many members each node stands for.
std::vector<std::uint32_t> member_counts(const Simplification& levels) {
  std::vector<std::uint32_t> counts(levels.spheres.size());
  for (std::size_t i = counts.size(); i-- > 0;) {
    counts[i] += static_cast<std::uint32_t>(levels.members_of(static_cast<std::uint32_t>(i)).size());
    if (const std::uint32_t parent = levels.spheres[i].parent; parent != no_parent) counts[parent] += counts[i];
  }
  return counts;
}

// For each sphere of the source model, the sphere of a level that stands for it, or -1.
std::vector<double> clusters_of(const MemberLists& members, std::size_t source_count) {
  std::vector<double> clusters(source_count, -1);
  for (std::size_t i = 0; i < members.count(); ++i) {
    for (const std::uint32_t m : members.of(i)) clusters.at(m) = static_cast<double>(i);
  }
  return clusters;
}

// What all rows of one listing are told from.
struct Table {
  const Listed& of;
  const api::SphereListing& listing;
  std::vector<std::uint32_t> nodes{}, counts{};
  MemberLists members{};
  std::vector<double> clusters{};

  Table(const Listed& listed, const api::SphereListing& wanted, bool with_members) : of(listed), listing(wanted) {
    if (of.levels == nullptr) return;
    const std::uint32_t level = of.level > 0 ? of.level : of.levels->last_level();
    if (std::ranges::any_of(listing.columns, api::is_of_levels)) counts = member_counts(*of.levels);
    if (listing.rows == api::SphereRows::spheres) nodes = shown_at(*of.levels, level);
    if (listing.rows == api::SphereRows::members || with_members) members = members_at(*of.levels, level);
    if (listing.rows == api::SphereRows::members) clusters = clusters_of(members, of.source->spheres.size());
  }

  std::uint64_t size() const {
    switch (listing.rows) {
      case api::SphereRows::spheres: return of.model.spheres.size();
      case api::SphereRows::nodes: return of.levels->spheres.size();
      case api::SphereRows::members: break;
    }
    return of.source->spheres.size();
  }
  std::uint32_t index(std::uint64_t row) const {
    return listing.order == api::SphereOrder::index ? static_cast<std::uint32_t>(row)
                                                    : of.contributions->ranking.order[row];
  }
  const Sphere& sphere(std::uint32_t i) const {
    switch (listing.rows) {
      case api::SphereRows::spheres: return of.model.spheres[i];
      case api::SphereRows::nodes: return of.levels->spheres[i].sphere;
      case api::SphereRows::members: break;
    }
    return of.source->spheres[i];
  }
  double value(api::SphereFigure figure, std::uint32_t i) const {
    using enum api::SphereFigure;
    if (figure == index) return i;
    if (figure == cluster) return clusters[i];
    if (api::is_contribution(figure)) return of.contributions->value(figure, i);
    const std::uint32_t at = listing.rows == api::SphereRows::nodes ? i : nodes[i];
    const LevelSphere& shown = of.levels->spheres[at];
    switch (figure) {
      case parent: return shown.parent == no_parent ? -1 : double(shown.parent);
      case level_from: return shown.from;
      case level_to: return shown.to;
      case members: return counts[at];
      default: break;
    }
    return at;
  }
};

}  // namespace

api::SpherePage rows(const Listed& of, const api::SphereListing& listing, bool members, std::uint64_t first,
                     std::uint64_t count) {
  const Table table(of, listing, members);
  api::SpherePage page{.total = table.size(), .spheres = {}, .columns = {}, .members = {}};
  first = std::min(first, page.total);
  count = std::min(count, page.total - first);
  page.spheres.reserve(count);
  for (std::uint64_t row = first; row < first + count; ++row) page.spheres.push_back(table.sphere(table.index(row)));
  for (const api::SphereFigure figure : listing.columns) {
    SphereColumn& column = page.columns.emplace_back(SphereColumn{std::string(api::name(figure)), {}});
    column.values.reserve(count);
    for (std::uint64_t row = first; row < first + count; ++row) {
      column.values.push_back(table.value(figure, table.index(row)));
    }
  }
  if (members) {
    page.members.emplace();
    for (std::uint64_t row = first; row < first + count; ++row) {
      const auto list = table.members.of(table.index(row));
      page.members->emplace_back(list.begin(), list.end());
    }
  }
  return page;
}

}  // namespace spherule::server
