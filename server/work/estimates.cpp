// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/estimates.h"

#include <array>
#include <optional>
#include <variant>
#include <vector>

#include "api/json/documents.h"
#include "server/work/memory.h"
#include "server/work/registration_job.h"

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

std::uint64_t to_write(Store& store, const api::DerivedRequest& request, const api::FileRequest& file) {
  const Resource model = store.find_model(request.model);
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

std::uint64_t to_list(Store& store, const Resource& model, const api::ExportRequest& wanted) {
  std::optional<ModelSize> source;
  const auto simplification = api::model_from(model.document).simplification;
  if (simplification && wanted.listing.rows == api::SphereRows::members)
    source = size_of(store, simplification->request.model);
  return memory_to_list(wanted, size_of(store, model), source);
}

}  // namespace

std::uint64_t memory_for(Store& store, const api::ModelRequest& request) {
  return memory_to_count(server::size_of(volume_info(store, request.volume)));
}

std::uint64_t memory_for(Store& store, const api::SimplificationRequest& request) {
  const Resource model = store.find_model(request.model);
  return memory_to_simplify(request.method, size_of(store, model), size_of(store, store.root_of(model)));
}

std::uint64_t memory_for(Store& store, const api::DerivedRequest& request) {
  if (const auto* slice = std::get_if<api::SliceRequest>(&request.what))
    return memory_to_slice(*slice, volume_info(store, slice->volume));
  if (const auto* values = std::get_if<api::ValuesRequest>(&request.what))
    return memory_to_count_values(server::size_of(volume_info(store, values->volume)));
  if (const auto* file = std::get_if<api::FileRequest>(&request.what)) return to_write(store, request, *file);
  const Resource model = store.find_model(request.model);
  if (const auto* wanted = std::get_if<api::ExportRequest>(&request.what)) return to_list(store, model, *wanted);
  const ModelSize size = size_of(store, model);
  if (const auto* render = std::get_if<api::RenderRequest>(&request.what)) {
    std::vector<ModelSize> sizes{size};
    if (!render->with.empty()) sizes.push_back(size_of(store, render->with));
    return memory_to_draw(render->options, sizes);
  }
  if (std::holds_alternative<api::ChecksRequest>(request.what)) return memory_to_check(size);
  if (std::holds_alternative<api::ContributionsRequest>(request.what)) return memory_to_measure_parts(size);
  if (std::holds_alternative<api::TreeRequest>(request.what)) return memory_to_show_tree(size);
  return memory_to_measure(size);
}

std::uint64_t memory_for(Store& store, const api::RegistrationRequest& request) {
  return memory_to_register(size_of(store, request.fixed), size_of(store, request.moving));
}

std::uint64_t memory_for(Store& store, const api::RegistrationAnswerRequest& request) {
  const api::RegistrationInfo info =
      registration_info(store.find(request.registration, registrations_collection, "registration"));
  const ModelSize fixed = size_of(store, info.request.fixed), moving = size_of(store, info.request.moving);
  if (const auto* what = std::get_if<api::Applied>(&request.what)) {
    static_cast<void>(volume_of(store, info.request.fixed));
    if (*what == api::Applied::volume) static_cast<void>(volume_of(store, info.request.moving));
    return memory_to_apply(*what, fixed, moving);
  }
  const std::array both{fixed, moving};
  return memory_to_draw(std::get<api::BeforeAfterRequest>(request.what).options, both);
}

}  // namespace spherule::server
