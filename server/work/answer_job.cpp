// SPDX-License-Identifier: GPL-3.0-or-later
#include <limits>
#include <optional>
#include <type_traits>
#include <utility>
#include <variant>

#include "api/json/documents.h"
#include "api/json/records.h"
#include "api/json/registration_documents.h"
#include "core/compare/marching_cubes.h"
#include "core/measure/checks.h"
#include "core/measure/report.h"
#include "core/register/picture.h"
#include "core/register/resample.h"
#include "core/render/render.h"
#include "core/render/slice_picture.h"
#include "core/slice/slice.h"
#include "core/write/export.h"
#include "core/write/export_file.h"
#include "core/write/write_nifti.h"
#include "server/records/listing.h"
#include "server/work/kinds.h"

namespace spherule::server {

namespace {

// What an answer is made with.
struct Making {
  Store& store;
  const api::DerivedRequest& request;
  JobContext& job;

  Resource model() const { return store.find_model(request.source); }
  Resource volume() const { return store.find_volume(request.source); }

  /// The model, or its level, from the store: the first tenth of the work. What follows is told of as `stage`.
  std::shared_ptr<const SphereModel> load(const Resource& resource, std::string_view stage) const {
    const Context context = job.context(0, 0.1);
    context.report("load", 0);
    auto model = store.load(resource, request.level, context);
    job.context(0.1, 0.95).report(stage, 0);
    return model;
  }
};

std::optional<api::ModelRequest> source_of(const Resource& model) { return api::model_from(model.document).source; }

std::string bytes_of(const Making& m, const api::MeasuresRequest&) {
  const Resource resource = m.model();
  const auto model = m.load(resource, "measures");
  std::optional<Volume> volume;
  const std::optional<api::ModelRequest> source = source_of(resource);
  if (source) volume.emplace(m.store.stored_volume(m.store.find_volume(source->volume), m.job.context(0.1, 0.15)));
  const UnionMeasures whole = m.store.union_of(resource, m.request.level, *model, m.job.context(0.15, 0.5));
  std::optional<MeasuredObject> object;
  if (source) object.emplace(MeasuredObject{*volume, source->rule});
  return api::measures_document(resource.id, measure_model(*model, whole, object, m.job.context(0.5, 0.95)));
}

std::string table_of(api::SphereFormat format, std::span<const Sphere> spheres,
                     const std::vector<SphereColumn>& columns) {
  switch (format) {
    case api::SphereFormat::csv: return spheres_to_csv(spheres, columns);
    case api::SphereFormat::npy: return spheres_to_npy(spheres, columns);
    case api::SphereFormat::ply: return spheres_to_ply(spheres, columns);
    case api::SphereFormat::vtp: break;
  }
  return spheres_to_vtp(spheres, columns);
}

std::string bytes_of(const Making& m, const api::ExportRequest& wanted) {
  const Resource resource = m.model();
  const auto model = m.load(resource, "export");
  const Context context = m.job.context(0.1, 0.95);
  const std::uint32_t level = m.request.level;
  const api::SphereListing& listing = wanted.listing;
  std::optional<Contributions> known;
  if (listing.needs_contributions()) known.emplace(m.store.union_of(resource, level, *model, context));
  if (listing.order == api::SphereOrder::index && listing.rows == api::SphereRows::spheres && listing.columns.empty())
    return table_of(wanted.format, model->spheres, {});
  const ListedParts parts = m.store.listed_parts(resource, listing, false, context);
  const api::SpherePage listed =
      rows({*model, known ? &*known : nullptr, parts.levels.get(), level, parts.source.get()}, listing, false, 0,
           std::numeric_limits<std::uint64_t>::max());
  return table_of(wanted.format, listed.spheres, listed.columns);
}

// A file for one other program.
std::string bytes_of(const Making& m, const api::FileRequest& wanted) {
  const Resource resource = m.model();
  const auto model = m.load(resource, "export");
  const Context context = m.job.context(0.1, 0.95);
  const std::optional<api::ModelRequest> source = source_of(m.store.root_of(resource));
  std::optional<Grid> scan;
  std::optional<InsideSamples> samples;
  if (source) {
    const Resource volume = m.store.find_volume(source->volume);
    scan = api::volume_from(volume.document).grid;
    if (mask_needs_samples(wanted.format, wanted.options, *model)) {
      samples.emplace(classify_samples(m.store.stored_volume(volume, context), source->rule, context));
    }
  }
  std::optional<UnionMeasures> whole;
  if (needs_union(wanted.format)) whole.emplace(m.store.union_of(resource, m.request.level, *model, context));
  return spheres_to_file(wanted.format,
                         {.spheres = model->spheres,
                          .scan = scan ? &*scan : nullptr,
                          .inside = samples ? &samples->inside : nullptr,
                          .whole = whole ? &*whole : nullptr},
                         wanted.options, context);
}

std::string bytes_of(const Making& m, const api::ChecksRequest&) {
  const Resource resource = m.model();
  const auto model = m.load(resource, "checks");
  const api::ModelRequest source = *source_of(resource);
  const Volume volume = m.store.stored_volume(m.store.find_volume(source.volume), m.job.context(0.1, 0.2));
  const InsideSamples samples = classify_samples(volume, source.rule, m.job.context(0.2, 0.25));
  return api::checks_document(resource.id,
                              check_model(*model, samples.inside, source.rule.border, m.job.context(0.25, 0.95)));
}

// The marching-cubes surface of the object that a model was made of.
Mesh surface_of(Store& store, const Resource& resource, const SphereModel& model, const Context& context) {
  const std::optional<api::ModelRequest> source = source_of(resource);
  if (!source || !model.solid) {
    throw Error(ErrorCode::unusable,
                "This model was not made from a volume, so it has no surface; draw the spheres, or the model that "
                "it was made from.");
  }
  const Volume volume = store.stored_volume(store.find_volume(source->volume), context);
  const InsideSamples samples = classify_samples(volume, source->rule, context);
  return marching_cubes(volume, source->rule, samples, model.solid->boundary, context);
}

std::string bytes_of(const Making& m, const api::RenderRequest& wanted) {
  Store& store = m.store;
  JobContext& job = m.job;
  std::vector<Resource> resources{m.model()};
  std::vector<std::shared_ptr<const SphereModel>> models{m.load(resources.front(), "render")};
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
      const UnionMeasures whole =
          store.union_of(resources[i], i == 0 ? m.request.level : 0, *models[i], job.context(0.15, 0.3));
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

std::string bytes_of(const Making& m, const api::TreeRequest& wanted) {
  const Resource resource = m.model();
  const Context loading = m.job.context(0, 0.1);
  loading.report("load", 0);
  const auto levels = m.store.load_levels(resource, loading);
  m.job.context(0.1, 0.95).report("tree", 0);
  std::vector<std::uint32_t> numbers = wanted.levels;
  if (numbers.empty()) {
    for (std::uint64_t k = 1; k < levels->last_level(); k *= 8) numbers.push_back(static_cast<std::uint32_t>(k));
    numbers.push_back(levels->last_level());
  }
  return api::tree_document(resource.id, api::model_from(resource.document).simplification->request.model, numbers,
                            tree_of(*levels, numbers), members_at(*levels, numbers.back()));
}

// A slice of a volume, as numbers or as a picture.
std::string bytes_of(const Making& m, const api::SliceRequest& wanted) {
  JobContext& job = m.job;
  const Volume volume = m.store.stored_volume(m.volume(), job.context(0, 0.4));
  const Volume plane = slice_of(volume, wanted.axis, wanted.index);
  std::optional<PlaneModel> model;
  if (wanted.object) {
    model.emplace(build_plane_model(plane, *wanted.object, m.store.config.max_boundary_points, job.context(0.4, 0.7)));
  }
  const PlaneModel* object = model ? &*model : nullptr;
  if (wanted.format == api::FigureFormat::json)
    return api::slice_document(m.request.source, wanted, plane.grid, object);
  const Context context = job.context(0.7, 0.95);
  Window window;
  if (wanted.options.image) window = wanted.options.window ? *wanted.options.window : usual_window(volume, context);
  SlicePicture picture = draw_slice(plane, wanted.axis, wanted.index, object, window, wanted.options, context);
  if (wanted.format == api::FigureFormat::svg)
    return to_svg(picture.drawing, encode_png(picture.image, context), context);
  paint(picture.drawing, picture.image, context);
  return encode_png(picture.image, context);
}

std::string bytes_of(const Making& m, const api::ValuesRequest& wanted) {
  const Resource resource = m.volume();
  const Volume volume = m.store.stored_volume(resource, m.job.context(0, 0.6));
  return api::record_of(
      value_histogram(volume, api::volume_from(resource.document).range, wanted.buckets, m.job.context(0.6, 0.95)));
}

api::RegistrationInfo registration(const Making& m) {
  m.job.context(0, 1).report("load", 0);
  return m.store.find_registration(m.request.source);
}

std::string bytes_of(const Making& m, const api::BeforeAfterRequest& wanted) {
  const api::RegistrationInfo info = registration(m);
  std::shared_ptr<const SphereModel> fixed, moving;
  if (wanted.few) {
    fixed = std::make_shared<const SphereModel>(SphereModel{.spheres = info.fixed_spheres, .solid = {}});
    moving = std::make_shared<const SphereModel>(SphereModel{.spheres = info.moving_spheres, .solid = {}});
  } else {
    fixed = m.store.load(m.store.find_model(info.request.fixed), m.job.context(0, 0.1));
    moving = m.store.load(m.store.find_model(info.request.moving), m.job.context(0.1, 0.2));
  }
  const Context context = m.job.context(0.2, 0.95);
  return encode_png(before_and_after(*fixed, *moving, info.moving_to_fixed, wanted.options, context), context);
}

std::string bytes_of(const Making& m, const api::AppliedRequest& wanted) {
  const api::RegistrationInfo info = registration(m);
  const Resource fixed = volume_of(m.store, info.request.fixed);
  const Grid grid = api::volume_from(fixed.document).grid;
  const auto map = info.moving_to_fixed;
  if (wanted.what == api::Applied::model) {
    const auto model = m.store.load(m.store.find_model(info.request.moving), m.job.context(0, 0.2));
    return volume_to_nifti(sampled(*model, map, grid, m.job.context(0.2, 0.95)));
  }
  const Volume volume = m.store.stored_volume(volume_of(m.store, info.request.moving), m.job.context(0, 0.3));
  return volume_to_nifti(resampled(volume, map, grid, m.job.context(0.3, 0.95)));
}

// Makes an answer durable.
Resource kept(const Making& m, const std::string& id, const std::string& bytes) {
  const Context context = m.job.context(0.95, 1);
  context.throw_if_cancelled();
  context.report("store", 0);
  Resource answer;
  answer.collection = answers_collection;
  answer.bytes = bytes.size();
  answer.blobs = {m.store.put_answer(id, bytes)};
  return answer;
}

Resource contributions(const Making& m) {
  const auto model = m.load(m.model(), "contributions");
  return m.store.keep(m.request.source, m.request.level, measure_union(*model, m.job.context(0.1, 0.95)));
}

}  // namespace

Resource run(Store& store, const api::DerivedRequest& request, const std::string& id, JobContext& job) {
  const Making making{store, request, job};
  return std::visit(
      [&]<typename What>(const What& what) {
        if constexpr (std::is_same_v<What, api::ContributionsRequest>)
          return contributions(making);
        else
          return kept(making, id, bytes_of(making, what));
      },
      request.what);
}

}  // namespace spherule::server
