// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/answer_job.h"

#include <limits>
#include <optional>
#include <utility>
#include <variant>

#include "api/json/documents.h"
#include "core/compare/marching_cubes.h"
#include "core/measure/checks.h"
#include "core/measure/report.h"
#include "core/render/render.h"
#include "core/render/slice_picture.h"
#include "core/slice/slice.h"
#include "core/write/export.h"
#include "core/write/export_file.h"
#include "server/records/listing.h"

namespace spherule::server {

namespace {

std::string measures(Store& store, const Resource& resource, std::uint32_t level, const SphereModel& model,
                     JobContext& job) {
  std::optional<Volume> volume;
  const std::optional<api::ModelRequest> source = api::model_from(resource.document).source;
  if (source) volume.emplace(store.stored_volume(store.find_volume(source->volume), job.context(0.1, 0.15)));
  const UnionMeasures whole = store.union_of(resource, level, model, job.context(0.15, 0.5));
  std::optional<MeasuredObject> object;
  if (source) object.emplace(MeasuredObject{*volume, source->rule});
  return api::measures_document(resource.id, measure_model(model, whole, object, job.context(0.5, 0.95)));
}

std::string exported(Store& store, const Resource& resource, std::uint32_t level, const SphereModel& model,
                     const api::ExportRequest& wanted, const Context& context) {
  const api::SphereListing& listing = wanted.listing;
  std::optional<Contributions> known;
  if (listing.needs_contributions()) known.emplace(store.union_of(resource, level, model, context));
  api::SpherePage listed;
  std::span<const Sphere> spheres = model.spheres;
  if (listing.order != api::SphereOrder::index || listing.rows != api::SphereRows::spheres ||
      !listing.columns.empty()) {
    const ListedParts parts = store.listed_parts(resource, listing, false, context);
    listed = rows({model, known ? &*known : nullptr, parts.levels.get(), level, parts.source.get()}, listing, false, 0,
                  std::numeric_limits<std::uint64_t>::max());
    spheres = listed.spheres;
  }
  switch (wanted.format) {
    case api::SphereFormat::csv: return spheres_to_csv(spheres, listed.columns);
    case api::SphereFormat::npy: return spheres_to_npy(spheres, listed.columns);
    case api::SphereFormat::ply: return spheres_to_ply(spheres, listed.columns);
    case api::SphereFormat::vtp: break;
  }
  return spheres_to_vtp(spheres, listed.columns);
}

// A file for one other program.
std::string file(Store& store, const Resource& resource, std::uint32_t level, const SphereModel& model,
                 const api::FileRequest& wanted, const Context& context) {
  const std::optional<api::ModelRequest> source = api::model_from(store.root_of(resource).document).source;
  std::optional<Grid> scan;
  std::optional<InsideSamples> samples;
  if (source) {
    const Resource volume = store.find_volume(source->volume);
    scan = api::volume_from(volume.document).grid;
    if (mask_needs_samples(wanted.format, wanted.options, model)) {
      samples.emplace(classify_samples(store.stored_volume(volume, context), source->rule, context));
    }
  }
  std::optional<UnionMeasures> whole;
  if (needs_union(wanted.format)) whole.emplace(store.union_of(resource, level, model, context));
  return spheres_to_file(wanted.format,
                         {.spheres = model.spheres,
                          .scan = scan ? &*scan : nullptr,
                          .inside = samples ? &samples->inside : nullptr,
                          .whole = whole ? &*whole : nullptr},
                         wanted.options, context);
}

std::string checks(Store& store, const Resource& resource, const SphereModel& model, JobContext& job) {
  const api::ModelRequest source = *api::model_from(resource.document).source;
  const Volume volume = store.stored_volume(store.find_volume(source.volume), job.context(0.1, 0.2));
  const InsideSamples samples = classify_samples(volume, source.rule, job.context(0.2, 0.25));
  return api::checks_document(resource.id,
                              check_model(model, samples.inside, source.rule.border, job.context(0.25, 0.95)));
}

// The marching-cubes surface of the object that a model was made of.
Mesh surface_of(Store& store, const Resource& resource, const SphereModel& model, const Context& context) {
  const std::optional<api::ModelRequest> source = api::model_from(resource.document).source;
  if (!source || !model.solid) {
    throw Error(ErrorCode::unusable,
                "This model was not made from a volume, so it has no surface; draw the spheres, or the model that "
                "it was made from.");
  }
  const Volume volume = store.stored_volume(store.find_volume(source->volume), context);
  const InsideSamples samples = classify_samples(volume, source->rule, context);
  return marching_cubes(volume, source->rule, samples, model.solid->boundary, context);
}

std::string pictures(Store& store, const Resource& resource, std::uint32_t level,
                     const std::shared_ptr<const SphereModel>& model, const api::RenderRequest& wanted,
                     JobContext& job) {
  std::vector<Resource> resources{resource};
  std::vector<std::shared_ptr<const SphereModel>> models{model};
  if (!wanted.with.empty()) {
    resources.push_back(store.find_model(wanted.with));
    models.push_back(store.load(resources.back(), job.context(0.1, 0.15)));
  }
  std::vector<Mesh> surfaces(models.size());
  std::vector<std::vector<double>> volumes(models.size());
  std::vector<Subject> subjects;
  for (std::size_t i = 0; i < models.size(); ++i) {
    if (wanted.options.style == Style::surface) {
      surfaces[i] = surface_of(store, resources[i], *models[i], job.context(0.15, 0.3));
    }
    if (wanted.options.colour_by == ColourBy::contribution) {
      const UnionMeasures whole = store.union_of(resources[i], i == 0 ? level : 0, *models[i], job.context(0.15, 0.3));
      for (const BallPart& part : whole.parts) {
        volumes[i].push_back(part.volume_mm3);
      }
    }
    subjects.push_back({.model = models[i].get(), .surface = &surfaces[i], .contributions_mm3 = volumes[i]});
  }
  const Context context = job.context(0.3, 0.95);
  const std::vector<Image> frames = render(subjects, wanted.options, context);
  constexpr int kFramesPerSecond = 15;
  return wanted.options.turntable > 0 ? encode_gif(frames, kFramesPerSecond, context)
                                      : encode_png(frames.front(), context);
}

std::string tree(Store& store, const Resource& resource, const api::TreeRequest& wanted, const Context& context) {
  const auto levels = store.load_levels(resource, context);
  std::vector<std::uint32_t> numbers = wanted.levels;
  if (numbers.empty()) {
    for (std::uint64_t k = 1; k < levels->last_level(); k *= 8) numbers.push_back(static_cast<std::uint32_t>(k));
    numbers.push_back(levels->last_level());
  }
  return api::tree_document(resource.id, api::model_from(resource.document).simplification->request.model, numbers,
                            tree_of(*levels, numbers), members_at(*levels, numbers.back()));
}

// A slice of a volume, as numbers or as a picture.
std::string slice(Store& store, const Resource& resource, const api::SliceRequest& wanted, JobContext& job) {
  const Volume volume = store.stored_volume(resource, job.context(0, 0.4));
  const Volume plane = slice_of(volume, wanted.axis, wanted.index);
  std::optional<PlaneModel> model;
  if (wanted.object) {
    model.emplace(build_plane_model(plane, *wanted.object, store.config.max_boundary_points, job.context(0.4, 0.7)));
  }
  const PlaneModel* object = model ? &*model : nullptr;
  if (wanted.format == api::FigureFormat::json) return api::slice_document(wanted, plane.grid, object);
  const Context context = job.context(0.7, 0.95);
  Window window;
  if (wanted.options.image) window = wanted.options.window ? *wanted.options.window : usual_window(volume, context);
  SlicePicture picture = draw_slice(plane, wanted.axis, wanted.index, object, window, wanted.options, context);
  if (wanted.format == api::FigureFormat::svg)
    return to_svg(picture.drawing, encode_png(picture.image, context), context);
  paint(picture.drawing, picture.image, context);
  return encode_png(picture.image, context);
}

// Makes an answer durable.
Resource kept(Store& store, const JobRecord& record, std::vector<std::string> inputs, const std::string& bytes,
              JobContext& job) {
  const Context context = job.context(0.95, 1);
  context.throw_if_cancelled();
  context.report("store", 0);
  Resource answer;
  answer.id = record.result_id;
  answer.collection = answers_collection;
  answer.request = record.request;
  answer.inputs = std::move(inputs);
  answer.bytes = bytes.size();
  answer.blobs = {store.put_answer(record.result_id, bytes)};
  return answer;
}

}  // namespace

Resource run_answer(Store& store, const JobRecord& record, JobContext& job) {
  const api::DerivedRequest request = api::derived_from(record.request);
  if (const auto* wanted = std::get_if<api::SliceRequest>(&request.what)) {
    return kept(store, record, {wanted->volume}, slice(store, store.find_volume(wanted->volume), *wanted, job), job);
  }
  if (const auto* wanted = std::get_if<api::ValuesRequest>(&request.what)) {
    const Resource volume = store.find_volume(wanted->volume);
    const auto counts =
        value_histogram(store.stored_volume(volume, job.context(0, 0.6)), api::volume_from(volume.document).range,
                        wanted->buckets, job.context(0.6, 0.95));
    return kept(store, record, {wanted->volume}, api::record_of(counts), job);
  }
  const Resource resource = store.find_model(request.model);
  Context context = job.context(0, 0.1);
  context.report("load", 0);
  const std::shared_ptr<const SphereModel> model = store.load(resource, request.level, context);
  context = job.context(0.1, 0.95);
  context.report(record.kind, 0);
  if (std::holds_alternative<api::ContributionsRequest>(request.what)) {
    return store.keep(request.model, request.level, measure_union(*model, context));
  }
  std::string bytes;
  if (std::holds_alternative<api::MeasuresRequest>(request.what)) {
    bytes = measures(store, resource, request.level, *model, job);
  }
  if (std::holds_alternative<api::ChecksRequest>(request.what)) bytes = checks(store, resource, *model, job);
  if (const auto* render = std::get_if<api::RenderRequest>(&request.what)) {
    bytes = pictures(store, resource, request.level, model, *render, job);
  }
  if (const auto* wanted = std::get_if<api::ExportRequest>(&request.what)) {
    bytes = exported(store, resource, request.level, *model, *wanted, context);
  }
  if (const auto* wanted = std::get_if<api::TreeRequest>(&request.what))
    bytes = tree(store, resource, *wanted, context);
  if (const auto* wanted = std::get_if<api::FileRequest>(&request.what)) {
    bytes = file(store, resource, request.level, *model, *wanted, context);
  }
  std::vector<std::string> inputs{request.model};
  if (const auto* render = std::get_if<api::RenderRequest>(&request.what); render != nullptr && !render->with.empty()) {
    inputs.push_back(render->with);
  }
  return kept(store, record, std::move(inputs), bytes, job);
}

}  // namespace spherule::server
