// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/records/store.h"

#include <algorithm>
#include <limits>
#include <system_error>
#include <utility>

#include "api/json/records.h"
#include "api/json/registration_documents.h"
#include "api/json/work.h"
#include "core/pipeline.h"
#include "core/read/read.h"
#include "server/base/disk.h"
#include "server/bytes/model_blob.h"
#include "server/bytes/union_blob.h"

namespace spherule::server {

namespace fs = std::filesystem;

std::string algorithm_version_text() { return std::to_string(algorithm_version); }

void not_found(const char* what) {
  throw Error(ErrorCode::not_found, std::string("There is no such ") + what + "; it was deleted or never made.");
}

api::Content content_of(const std::shared_ptr<const Blob>& blob) {
  return {.bytes = blob->size(),
          .sha256 = blob->sha256(),
          .read_at = [blob](std::uint64_t offset, std::span<char> out) { return blob->read_at(offset, out); },
          .file = blob->descriptor()};
}

void Stopwatch::lap(const std::string& stage) {
  const auto now = std::chrono::steady_clock::now();
  seconds_[stage] = std::chrono::duration<double>(now - last_).count();
  last_ = now;
}

namespace {

// The data folder, when it is one: a folder that happens to hold more is its owner's business.
void make_private(const fs::path& data) {
  constexpr auto others = fs::perms::group_all | fs::perms::others_all;
  std::error_code ignored;  // another owner's, or not there
  const fs::perms given = fs::status(data, ignored).permissions();
  if ((given & fs::perms::sticky_bit) == fs::perms::none)
    fs::permissions(data, others, fs::perm_options::remove, ignored);
  for (const char* name : {"blobs", "blobs/.tmp", "uploads", "replies", "damaged", "audit.log"})
    fs::permissions(data / name, others, fs::perm_options::remove, ignored);
}

// Before anything is made: an empty catalogue would be as lost as none.
const fs::path& opened(const Config& config, const fs::path& catalog) {
  make_folder(config.data);
  if (fs::exists(catalog))
    make_private(config.data);
  else if (!FileBlobStore::keys_in(config.blob_folder()).empty())
    throw_lost_catalogue();
  return catalog;
}

}  // namespace

Store::Store(const Config& given, AsideLog aside, ExpiryLog expiry)
    : config(given),
      aside_log(std::move(aside)),
      expiry_log(std::move(expiry)),
      catalog(opened(given, given.catalog_file())),
      blobs((given.blob_folder())),
      cache(given.model_cache_bytes),
      levels(given.model_cache_bytes / 4),
      contributions(given.model_cache_bytes / 4),
      open_blobs(256),
      heavy(static_cast<std::ptrdiff_t>(given.jobs_at_once)) {
  catalog.reserve_room();
  sort_out_orphans(catalog, blobs, [&](const std::string& key) {
    set_aside(config.data, config.blob_folder() / key, key);
    if (aside_log) aside_log(key);
  });
}

void Store::put_aside(const fs::path& file, const std::string& name) noexcept try {
  if (!fs::exists(file)) return;
  set_aside(config.data, file, name);
  if (aside_log) aside_log(name);
} catch (const std::exception&) {
  // It stays where it is, and is tried again when it is met again.
}

Surroundings Store::surroundings() {
  return {.served = [this] { return catalog.served(); },
          .free_bytes = [this] { return blobs.free_bytes(); },
          .set_aside =
              [this](const fs::path& file) {
                put_aside(file, file.parent_path().filename().native() + "/" + file.filename().native());
              }};
}

void Store::make_room_for_answer(std::uint64_t bytes) {
  if (config.max_answer_bytes == 0) return;
  const std::uint64_t left = config.max_answer_bytes - std::min(config.max_answer_bytes, bytes);
  for (const std::string& id : catalog.over_budget(answers_collection, left)) try {
      remove(id);
      if (expiry_log) expiry_log(id);
    } catch (const Error& error) {
      if (error.code() != ErrorCode::not_found) throw;  // else somebody else was faster
    }
}

std::string Store::put_answer(const std::string& id, std::string_view bytes) {
  make_room_for_answer(bytes.size());
  return blobs.put("answers/" + id, bytes);
}

std::vector<Keeping> Store::keeping() const {
  return {{answers_collection, config.keep_answers},
          {models_collection, config.keep_models},
          {volumes_collection, config.keep_volumes}};
}

bool Store::is_to_be_noted(const Resource& resource) const {
  std::chrono::seconds shortest{0};
  const auto consider = [&](std::chrono::seconds time) {
    if (time.count() > 0 && (shortest.count() == 0 || time < shortest)) shortest = time;
  };
  for (const Keeping& keep : keeping()) consider(keep.unused);
  if (config.max_answer_bytes > 0 && resource.collection == answers_collection) consider(std::chrono::hours(10));
  return shortest.count() > 0 && catalog.served() - resource.used >= use_is_noted_after(shortest);
}

std::optional<Resource> Store::find_any(const std::string& id) {
  auto resource = catalog.find(id);
  if (resource && is_to_be_noted(*resource)) try {
      catalog.touch(id);
    } catch (const Error&) {
      // What cannot be noted, on a disk that is full or read-only, can be read and deleted all the same.
    }
  return resource;
}

void Store::remove(const std::string& id) {
  for (const std::string& key : withdraw(catalog, blobs, id)) open_blobs.erase(key);
  cache.erase(id);
  levels.erase(id);
  contributions.erase(contributions_id(id, 0));
}

void Store::require(const std::string& id, const char* collection, const char* what) const {
  if (!catalog.holds(id, collection)) not_found(what);
}

std::shared_ptr<const Blob> Store::intact(const std::string& key) {
  return open_blobs.get_or_load(key, [&] {
    auto blob = std::make_shared<Blob>(blobs.open(key));
    blob->verify();
    return Cache<Blob>::Loaded{std::move(blob), 1};
  });
}

Resource Store::find(const std::string& id, const char* collection, const char* what) {
  auto resource = find_any(id);
  if (!resource || resource->collection != collection) not_found(what);
  return std::move(*resource);
}

api::RegistrationInfo Store::find_registration(const std::string& id) {
  const Resource resource = find(id, registrations_collection, "registration");
  return api::registration_from(resource.document, resource.request);
}

Resource Store::root_of(Resource model) {
  while (const auto simplification = api::model_from(model.document).simplification) {
    model = find_model(simplification->request.model);
  }
  return model;
}

Volume Store::read(const std::vector<api::StoredFile>& files, const std::function<Blob(std::size_t file)>& open,
                   const api::VolumeParameters& parameters, const Context& context,
                   std::function<void(std::size_t bytes)> admit) const {
  ReadOptions options{.raw = parameters.raw, .frame = parameters.frame, .grid = parameters.grid, .limits = {}};
  options.limits.max_voxels = config.max_voxels;
  options.limits.max_bytes = config.max_decompressed_bytes;
  options.limits.admit = std::move(admit);
  if (files.size() == 1) {
    const Blob only = open(0);
    return read_volume({only.path()}, options, context);
  }
  ScratchFolder folder(blobs.scratch_root());
  std::vector<std::filesystem::path> paths;
  for (std::size_t i = 0; i < files.size(); ++i) paths.push_back(folder.link(open(i), files[i].name));
  return read_volume(paths, options, context);
}

Volume Store::stored_volume(const Resource& resource, const Context& context) const {
  const api::VolumeInfo info = api::volume_from(resource.document);
  const auto open = [&](std::size_t file) {
    Blob blob = blobs.open(resource.blobs.at(file));
    blob.verify(context);
    return blob;
  };
  return read(info.files, open, info.parameters, context);
}

std::shared_ptr<const SphereModel> Store::load(const Resource& resource, const Context& context, const Admit& admit) {
  const auto read = [&] {
    if (admit) admit(bytes_to_load(resource.bytes, api::model_from(resource.document).spheres));
    const Permit permit(*this, context);
    const Blob blob = blobs.open(resource.blobs.at(0));
    blob.verify(context);
    const auto model = std::make_shared<const SphereModel>(read_model(blob, context));
    return Cache<SphereModel>::Loaded{model, bytes_in_memory(*model)};
  };
  return cache.get_or_load(resource.id, read, context);
}

std::shared_ptr<const SphereModel> Store::load(const Resource& resource, std::uint32_t level, const Context& context,
                                               const Admit& admit) {
  if (level == 0) return load(resource, context, admit);
  return std::make_shared<const SphereModel>(
      SphereModel{.spheres = spheres_at(*load_levels(resource, context, admit), level), .solid = {}});
}

std::shared_ptr<const Simplification> Store::load_levels(const Resource& resource, const Context& context,
                                                         const Admit& admit) {
  const auto read = [&] {
    if (admit) admit(resource.bytes);
    const Permit permit(*this, context);
    const Blob blob = blobs.open(resource.blobs.at(0));
    blob.verify(context);
    const auto loaded = std::make_shared<const Simplification>(read_levels(blob));
    return Cache<Simplification>::Loaded{loaded, bytes_in_memory(*loaded)};
  };
  return levels.get_or_load(resource.id, read, context);
}

ListedParts Store::listed_parts(const Resource& resource, const api::SphereListing& listing, bool members,
                                const Context& context, const Admit& admit) {
  ListedParts parts;
  if (listing.needs_levels() || members) parts.levels = load_levels(resource, context, admit);
  if (listing.rows == api::SphereRows::members) {
    parts.source = load(find_model(api::model_from(resource.document).simplification->request.model), context, admit);
  }
  return parts;
}

Resource Store::keep(api::ModelInfo& info,
                     const std::function<void(const std::function<void(std::string_view)>&)>& write, Stopwatch& watch,
                     const Context& context) {
  const auto staging = blobs.stage(std::numeric_limits<std::uint64_t>::max());
  write([&](std::string_view piece) {
    context.throw_if_cancelled();
    staging->append(piece);
  });
  static_cast<void>(api::record_of(info));  // what cannot be recorded is not committed
  Resource resource;
  resource.id = info.id;
  resource.collection = models_collection;
  resource.bytes = staging->size();
  resource.blobs = {staging->commit("models/" + info.id)};
  watch.lap("store");
  info.timings_s = watch.seconds();
  info.created = now();
  resource.document = api::record_of(info);
  return resource;
}

Resource Store::keep(api::ModelInfo& info, SphereModel&& model, Stopwatch& watch, const Context& context) {
  Resource resource = keep(
      info, [&](const auto& append) { write_model(model, append); }, watch, context);
  cache.get_or_load(info.id, [&] {
    const std::size_t bytes = bytes_in_memory(model);
    return Cache<SphereModel>::Loaded{std::make_shared<const SphereModel>(std::move(model)), bytes};
  });
  return resource;
}

Resource Store::keep(api::ModelInfo& info, const Simplification& simplified, Stopwatch& watch, const Context& context) {
  return keep(
      info, [&](const auto& append) { write_levels(simplified, append); }, watch, context);
}

std::string Store::contributions_id(const std::string& model, std::uint32_t level) {
  return content_id(
      "ans", api::identity_of(api::DerivedRequest{.source = model, .what = api::ContributionsRequest{}, .level = level},
                              algorithm_version_text()));
}

UnionMeasures Store::read_union_of(const Resource& answer, const SphereModel& model, const Context& context) const {
  const Blob blob = blobs.open(answer.blobs.at(0));
  blob.verify(context);
  UnionMeasures whole = read_union(blob);
  if (whole.parts.size() != model.spheres.size()) {
    throw Error(ErrorCode::corrupt, "The stored measures are of another model; delete the model and make it again.");
  }
  return whole;
}

Resource Store::keep(const std::string& model, std::uint32_t level, const UnionMeasures& whole) {
  const auto staging = blobs.stage(std::numeric_limits<std::uint64_t>::max());
  write_union(whole, [&](std::string_view piece) { staging->append(piece); });
  Resource answer;
  answer.id = contributions_id(model, level);
  answer.collection = answers_collection;
  answer.request =
      api::record_of(api::DerivedRequest{.source = model, .what = api::ContributionsRequest{}, .level = level});
  answer.inputs = {model};
  answer.bytes = staging->size();
  make_room_for_answer(answer.bytes);
  answer.blobs = {staging->commit("answers/" + answer.id)};
  return answer;
}

UnionMeasures Store::union_of(const Resource& resource, std::uint32_t level, const SphereModel& model,
                              const Context& context) {
  if (const auto known = catalog.find(contributions_id(resource.id, level))) try {
      return read_union_of(*known, model, context);
    } catch (const Error& error) {
      if (error.code() != ErrorCode::corrupt && error.code() != ErrorCode::not_found) throw;
      remove(known->id);
    }
  UnionMeasures whole = measure_union(model, context);
  publish(catalog, blobs, keep(resource.id, level, whole));
  return whole;
}

void check_record(const Resource& resource) {
  if (resource.collection == volumes_collection) static_cast<void>(api::volume_from(resource.document));
  if (resource.collection == models_collection) static_cast<void>(api::model_from(resource.document));
  if (resource.collection == registrations_collection)
    static_cast<void>(api::registration_from(resource.document, resource.request));
}

}  // namespace spherule::server
