// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/bytes/model_blob.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "server/bytes/blob_format.h"

namespace spherule::server {

namespace {

using format::Reader;
using format::require;
using format::Writer;

static_assert(sizeof(LatticePoint) == 12 && sizeof(Tetrahedron) == 16 && sizeof(Sphere) == 32);

constexpr std::string_view kMagic = "SPHERULE";
constexpr std::uint32_t kVersion = 1;
constexpr std::uint32_t kRaw = 1, kPlain = 2, kLevels = 3;

bool is_ball(const Sphere& s) {
  return std::isfinite(s.centre.x) && std::isfinite(s.centre.y) && std::isfinite(s.centre.z) && s.radius >= 0 &&
         std::isfinite(s.radius);
}

void write_head(Writer& out, std::uint32_t kind) {
  out.put_all(std::span<const char>(kMagic));
  out.put(kVersion);
  out.put(kind);
}

std::uint32_t read_head(Reader& in) {
  std::array<char, kMagic.size()> magic{};
  in.get_all(std::span<char>(magic));
  require(std::string_view(magic.data(), magic.size()) == kMagic && in.get<std::uint32_t>() == kVersion);
  return in.get<std::uint32_t>();
}

Simplification read_levels_after_head(Reader& in) {
  const auto nodes = in.get<std::uint64_t>(), members = in.get<std::uint64_t>();
  constexpr std::uint64_t node_bytes = sizeof(Sphere) + 4 * sizeof(std::uint32_t);
  require(nodes >= 1 && nodes <= in.left() / node_bytes && members <= in.left() / sizeof(std::uint32_t));
  const std::vector<Sphere> spheres = in.get_vector<Sphere>(nodes);
  const auto links = in.get_vector<std::array<std::uint32_t, 3>>(nodes);
  Simplification levels;
  levels.spheres.reserve(nodes);
  for (std::size_t i = 0; i < nodes; ++i) {
    levels.spheres.push_back({.sphere = spheres[i], .parent = links[i][0], .from = links[i][1], .to = links[i][2]});
  }
  levels.member_begin = in.get_vector<std::uint32_t>(nodes + 1);
  levels.members = in.get_vector<std::uint32_t>(members);
  require(in.left() == 0 && std::ranges::all_of(spheres, is_ball));
  constexpr std::size_t most_members = std::size_t{1} << 30;
  const std::uint32_t largest = members > 0 ? std::ranges::max(levels.members) : 0;
  require(largest < most_members && is_valid(levels, largest + 1));
  return levels;
}

Solid read_solid(Reader& in) {
  Solid solid;
  Lattice& lattice = solid.boundary.lattice;
  Grid& grid = lattice.grid;
  for (std::int32_t& n : grid.dims) require((n = in.get<std::int32_t>()) >= 1);
  for (int a = 0; a < 3; ++a) grid.spacing[a] = in.get<double>();
  for (int a = 0; a < 3; ++a) grid.origin[a] = in.get<double>();
  for (Vec3& row : grid.direction.rows) {
    for (int a = 0; a < 3; ++a) row[a] = in.get<double>();
  }
  lattice.unit_mm = in.get<double>();
  require(lattice.unit_mm > 0 && std::isfinite(lattice.unit_mm));
  for (std::size_t a = 0; a < 3; ++a) {
    lattice.planes[a] = in.get_vector<std::int32_t>(static_cast<std::uint64_t>(grid.dims[a]) + 2);
    require(std::ranges::is_sorted(lattice.planes[a]));
  }
  solid.boundary.touches_border = in.get<std::uint64_t>() != 0;
  const auto points = in.get<std::uint64_t>(), cells = in.get<std::uint64_t>();
  solid.inside_count = in.get<std::uint64_t>();
  require(solid.inside_count <= cells && points <= in.left() / sizeof(LatticePoint) &&
          cells == (in.left() - points * sizeof(LatticePoint)) / sizeof(Tetrahedron));
  solid.boundary.points = in.get_vector<LatticePoint>(points);
  solid.cells = in.get_vector<Tetrahedron>(cells);
  constexpr std::int32_t limit = 1 << Lattice::coordinate_bits;
  require(std::ranges::all_of(solid.boundary.points, [](const LatticePoint& p) {
    return p.x >= 0 && p.x < limit && p.y >= 0 && p.y < limit && p.z >= 0 && p.z < limit;
  }));
  require(std::ranges::all_of(solid.cells, [&](const Tetrahedron& t) {
    return std::ranges::all_of(t, [&](std::uint32_t v) { return v < points; });
  }));
  return solid;
}

}  // namespace

void write_model(const SphereModel& model, const std::function<void(std::string_view)>& append) {
  Writer out(append);
  write_head(out, model.solid ? kRaw : kPlain);
  if (!model.solid) {
    out.put<std::uint64_t>(model.spheres.size());
    out.put_all(std::span<const Sphere>(model.spheres));
    return;
  }
  const BoundaryPoints& boundary = model.solid->boundary;
  const Grid& grid = boundary.lattice.grid;
  out.put(grid.dims);
  out.put(grid.spacing);
  out.put(grid.origin);
  out.put(grid.direction);
  out.put(boundary.lattice.unit_mm);
  for (const auto& planes : boundary.lattice.planes) out.put_all(std::span<const std::int32_t>(planes));
  out.put<std::uint64_t>(boundary.touches_border ? 1 : 0);
  out.put<std::uint64_t>(boundary.points.size());
  out.put<std::uint64_t>(model.solid->cells.size());
  out.put<std::uint64_t>(model.solid->inside_count);
  out.put_all(std::span<const LatticePoint>(boundary.points));
  out.put_all(std::span<const Tetrahedron>(model.solid->cells));
}

void write_levels(const Simplification& levels, const std::function<void(std::string_view)>& append) {
  Writer out(append);
  write_head(out, kLevels);
  out.put<std::uint64_t>(levels.spheres.size());
  out.put<std::uint64_t>(levels.members.size());
  std::vector<Sphere> spheres;
  std::vector<std::array<std::uint32_t, 3>> links;
  for (const LevelSphere& s : levels.spheres) {
    spheres.push_back(s.sphere);
    links.push_back({s.parent, s.from, s.to});
  }
  out.put_all(std::span<const Sphere>(spheres));
  out.put_all(std::span<const std::array<std::uint32_t, 3>>(links));
  out.put_all(std::span<const std::uint32_t>(levels.member_begin));
  out.put_all(std::span<const std::uint32_t>(levels.members));
}

Simplification read_levels(const Blob& blob) {
  Reader in(blob);
  require(read_head(in) == kLevels);
  return read_levels_after_head(in);
}

SphereModel read_model(const Blob& blob, const Context& context) {
  Reader in(blob);
  const std::uint32_t kind = read_head(in);
  SphereModel model;
  if (kind == kRaw) {
    model.solid = read_solid(in);
    const Solid& solid = *model.solid;
    model.spheres =
        circumspheres(solid.boundary.lattice, solid.boundary.points, solid.cells, solid.inside_count, context);
  } else if (kind == kLevels) {
    const Simplification levels = read_levels_after_head(in);
    model.spheres = spheres_at(levels, levels.last_level());
  } else {
    require(kind == kPlain);
    model.spheres = in.get_vector<Sphere>(in.get<std::uint64_t>());
    require(std::ranges::all_of(model.spheres, is_ball));
  }
  require(in.left() == 0);
  return model;
}

std::size_t bytes_in_memory(const SphereModel& model) {
  std::size_t bytes = sizeof model + model.spheres.capacity() * sizeof(Sphere);
  if (model.solid) {
    bytes += model.solid->boundary.points.capacity() * sizeof(LatticePoint) +
             model.solid->cells.capacity() * sizeof(Tetrahedron);
    for (const auto& planes : model.solid->boundary.lattice.planes) bytes += planes.capacity() * sizeof(std::int32_t);
  }
  return bytes;
}

std::size_t bytes_in_memory(const Simplification& levels) {
  return sizeof levels + levels.spheres.capacity() * sizeof(LevelSphere) +
         (levels.member_begin.capacity() + levels.members.capacity()) * sizeof(std::uint32_t);
}

}  // namespace spherule::server
