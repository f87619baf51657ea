// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/estimates.h"

#include <array>
#include <optional>
#include <variant>
#include <vector>

#include "api/json/records.h"
#include "server/work/kinds.h"
#include "server/work/memory.h"

namespace spherule::server {

namespace {

api::VolumeInfo volume_info(Store& store, const std::string& id) {
  return api::volume_from(store.find_volume(id).document);
}

ModelSize size_of(Store& store, const Resource& model) {
  const api::ModelInfo info = api::model_from(model.document);
  ModelSize size{.spheres = info.spheres,
                 .cells = info.tetrahedra,
                 .inside_cells = info.inside_tetrahedra,
                 .points = info.boundary_points,
                 .stored = model.bytes};
  std::optional<Grid> grid;
  if (const auto source = api::model_from(store.root_of(model).document).source) {
    const api::VolumeInfo volume = volume_info(store, source->volume);
    size.scan = server::size_of(volume);
    grid = volume.grid;
  }
  size.sampled = sampled_box(info.bounds, grid);
  return size;
}
ModelSize size_of(Store& store, const std::string& model) { return size_of(store, store.find_model(model)); }

api::RegistrationInfo registration(Store& store, const api::DerivedRequest& request) {
  return store.find_registration(request.source);
}

// Of what is derived: an overload a kind.

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::MeasuresRequest&) {
  return memory_to_measure(size_of(store, request.source));
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::ChecksRequest&) {
  return memory_to_check(size_of(store, request.source));
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::ContributionsRequest&) {
  return memory_to_measure_parts(size_of(store, request.source));
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::TreeRequest&) {
  return memory_to_show_tree(size_of(store, request.source));
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::RenderRequest& render) {
  std::vector<ModelSize> sizes{size_of(store, request.source)};
  if (!render.with.empty()) sizes.push_back(size_of(store, render.with));
  return memory_to_draw(render.options, sizes);
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::ExportRequest& wanted) {
  const Resource model = store.find_model(request.source);
  std::optional<ModelSize> source;
  const auto simplification = api::model_from(model.document).simplification;
  if (simplification && wanted.listing.rows == api::SphereRows::members)
    source = size_of(store, simplification->request.model);
  return memory_to_list(wanted, size_of(store, model), source);
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::FileRequest& file) {
  const Resource model = store.find_model(request.source);
  const api::ModelInfo info = api::model_from(model.document);
  const auto source = api::model_from(store.root_of(model).document).source;
  const std::uint64_t spheres = request.level > 0 ? request.level : info.spheres;
  check_exportable(file.format, spheres, source.has_value(), file.options);
  const ModelSize size = size_of(store, model);
  std::optional<Grid> scan;
  std::uint64_t samples = 0;
  if (file.format == FileFormat::nifti && source) {
    const api::VolumeInfo volume = volume_info(store, source->volume);
    scan = volume.grid;
    if (size.cells > 0 && !file.options.voxel_mm) samples = memory_to_count(server::size_of(volume));
  }
  return samples + (needs_union(file.format) ? memory_to_measure_parts(size) : size.loaded()) +
         memory_to_write(file, spheres, info.bounds, scan);
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::SliceRequest& slice) {
  return memory_to_slice(slice, volume_info(store, request.source));
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::ValuesRequest&) {
  return memory_to_count_values(server::size_of(volume_info(store, request.source)));
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::BeforeAfterRequest& picture) {
  const api::RegistrationInfo info = registration(store, request);
  const std::array both{size_of(store, info.request.fixed), size_of(store, info.request.moving)};
  return memory_to_draw(picture.options, both);
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request, const api::AppliedRequest& applied) {
  const api::RegistrationInfo info = registration(store, request);
  static_cast<void>(volume_of(store, info.request.fixed));
  if (applied.what == api::Applied::volume) static_cast<void>(volume_of(store, info.request.moving));
  return memory_to_apply(applied.what, size_of(store, info.request.fixed), size_of(store, info.request.moving));
}

// Of each kind of request.

std::uint64_t memory_of(Store& store, const api::ModelRequest& request) {
  return memory_to_count(server::size_of(volume_info(store, request.volume)));
}

std::uint64_t memory_of(Store& store, const api::SimplificationRequest& request) {
  const Resource model = store.find_model(request.model);
  return memory_to_simplify(request.method, size_of(store, model), size_of(store, store.root_of(model)));
}

std::uint64_t memory_of(Store& store, const api::RegistrationRequest& request) {
  return memory_to_register(size_of(store, request.fixed), size_of(store, request.moving));
}

std::uint64_t memory_of(Store& store, const api::DerivedRequest& request) {
  return std::visit([&](const auto& what) { return memory_of(store, request, what); }, request.what);
}

}  // namespace

std::uint64_t memory_for(Store& store, const api::WorkRequest& request) {
  return std::visit([&](const auto& wanted) { return memory_of(store, wanted); }, request);
}

}  // namespace spherule::server
