// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/fsck.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <system_error>

#include "core/base/error.h"
#include "server/blob_store.h"
#include "server/catalog.h"

namespace spherule::server {

namespace {

namespace fs = std::filesystem;
using Kind = Finding::Kind;

constexpr const char* catalog_name = "catalog.sqlite";
constexpr const char* blobs_name = "blobs";

[[noreturn]] void throw_no_catalog() {
  throw Error(ErrorCode::not_found, "There is no catalogue in this folder; name the data folder, or a backup of one.");
}

[[noreturn]] void throw_unwritable() {
  throw Error(ErrorCode::no_space, "The folder cannot be written; check its disk's space and its permissions.");
}

void move(const fs::path& from, const fs::path& to) {
  make_folder(to.parent_path());
  std::error_code failed;
  fs::rename(from, to, failed);
  if (failed && failed != std::errc::no_such_file_or_directory) throw_unwritable();
}

/// A name below damaged/ that is not taken.
fs::path place_for(const fs::path& data, std::string name) {
  std::ranges::replace(name, '/', '_');
  fs::path place = data / "damaged" / name;
  for (int i = 1; fs::exists(place); ++i) place = data / "damaged" / (name + "." + std::to_string(i));
  return place;
}

void replace_catalog(const fs::path& data, std::vector<Finding>& findings) {
  const fs::path file = data / catalog_name, fresh = data / "catalog.salvaged";
  const auto remove = [](const fs::path& base) {
    for (const char* end : {"", "-wal", "-shm", ".lock"}) fs::remove(base.native() + end);
  };
  remove(fresh);  // of a repair that was interrupted
  const Salvage salvage = salvage_catalog(file, fresh);
  if (salvage.lost > 0) findings.push_back({Kind::lost_row, std::to_string(salvage.lost)});
  const fs::path aside = place_for(data, catalog_name);
  make_folder(aside.parent_path());
  fs::create_hard_link(file, aside);
  // A write-ahead log would be taken for the new catalogue's.
  for (const char* end : {"-wal", "-shm"})
    if (fs::exists(file.native() + end)) move(file.native() + end, aside.native() + end);
  move(fresh, file);
  remove(fresh);
  sync_to_disk(data);
}

/// Nothing when the file is damaged.
std::unique_ptr<Catalog> open_sound(const fs::path& file, std::vector<Finding>& findings) {
  try {
    auto catalog = std::make_unique<Catalog>(file);
    catalog->verify();
    return catalog;
  } catch (const Error& error) {
    if (error.code() != ErrorCode::corrupt) throw;
    findings.push_back({Kind::damaged_catalogue, {}});
    return nullptr;
  }
}

template <typename F>
void for_each_resource(const Catalog& catalog, const F& f) {
  std::string cursor;
  do {
    const Page<Resource> page = catalog.list_all(cursor, 1000);
    std::ranges::for_each(page.items, f);
    cursor = page.next;
  } while (!cursor.empty());
}

/// What is wrong with a resource's blobs.
std::optional<Kind> fault_of(const Resource& resource, const BlobStore& blobs) {
  try {
    for (const std::string& key : resource.blobs) blobs.open(key).verify();
  } catch (const Error& error) {
    if (error.code() == ErrorCode::not_found) return Kind::missing_blob;
    if (error.code() == ErrorCode::corrupt) return Kind::damaged_blob;
    throw;
  }
  return {};
}

/// A hard link where that is possible; a copy elsewhere. False when the blob is gone.
bool copy_blob(const fs::path& from, const fs::path& to) {
  make_folder(to.parent_path());
  std::error_code failed;
  fs::create_hard_link(from, to, failed);
  if (!failed) return true;
  if (failed == std::errc::no_such_file_or_directory) return false;
  fs::copy_file(from, to, failed);
  if (failed == std::errc::no_such_file_or_directory) return false;
  if (failed) throw_unwritable();
  sync_to_disk(to);
  return true;
}

}  // namespace

std::string_view to_string(Kind kind) {
  switch (kind) {
    case Kind::damaged_catalogue: return "the catalogue is damaged";
    case Kind::lost_row: return "rows of the catalogue that are lost";
    case Kind::missing_blob: return "a blob is missing";
    case Kind::damaged_blob: return "a blob is damaged";
    case Kind::unowned_blob: break;
  }
  return "nothing owns this blob";
}

StoreReport check_store(const fs::path& data, bool repair) {
  const fs::path file = data / catalog_name;
  if (!fs::exists(file)) throw_no_catalog();
  StoreReport report;
  std::unique_ptr<Catalog> catalog = open_sound(file, report.findings);
  if (!catalog) {
    if (!repair) return report;
    replace_catalog(data, report.findings);
    catalog = open_sound(file, report.findings);
    if (!catalog) throw_no_catalog();
  }
  FileBlobStore blobs(data / blobs_name);
  const auto set_aside = [&](const std::string& key) { move(data / blobs_name / key, place_for(data, key)); };

  std::vector<std::string> faulty;
  for_each_resource(*catalog, [&](const Resource& resource) {
    const std::optional<Kind> fault = fault_of(resource, blobs);
    if (!fault) return;
    report.findings.push_back({*fault, resource.id});
    faulty.push_back(resource.id);
  });
  for (const std::string& key : blobs.keys())
    if (!catalog->owns_blob(key)) {
      report.findings.push_back({Kind::unowned_blob, key});
      if (repair) set_aside(key);
    }
  if (repair)
    for (const std::string& id : faulty)
      if (catalog->find(id))  // else it went with what it was made from
        std::ranges::for_each(catalog->erase(id), set_aside);
  for_each_resource(*catalog, [&](const Resource& resource) {
    if (!repair && std::ranges::find(faulty, resource.id) != faulty.end()) return;
    ++report.resources;
    report.blobs += resource.blobs.size();
    report.bytes += resource.bytes;
  });
  return report;
}

StoreReport copy_store(const fs::path& from, const fs::path& to) {
  const fs::path file = to / catalog_name, partial = to / "catalog.partial";
  if (!fs::exists(from / catalog_name)) throw_no_catalog();
  if (fs::exists(file) || fs::exists(to / blobs_name))
    throw Error(ErrorCode::conflict, "The folder to copy to holds data already; name a new one.");
  make_folder(to);
  for (const char* end : {"", "-wal", "-shm", ".lock"}) fs::remove(partial.native() + end);
  copy_catalog(from / catalog_name, partial);
  {
    const Catalog catalog(partial);
    // What is not there any more comes up when the copy is checked.
    for_each_resource(catalog, [&](const Resource& resource) {
      for (const std::string& key : resource.blobs) copy_blob(from / blobs_name / key, to / blobs_name / key);
    });
  }
  fs::remove(partial.native() + ".lock");
  make_folder(to / blobs_name);
  for (const fs::directory_entry& folder : fs::directory_iterator(to / blobs_name)) sync_to_disk(folder.path());
  sync_to_disk(to / blobs_name);
  move(partial, file);
  sync_to_disk(to);
  return check_store(to, true);
}

}  // namespace spherule::server
