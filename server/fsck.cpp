// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/fsck.h"

#include <algorithm>
#include <array>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <memory>
#include <optional>
#include <system_error>

#include "core/base/error.h"
#include "server/base/disk.h"
#include "server/bytes/aside.h"
#include "server/bytes/blob_store.h"
#include "server/intake/resumable.h"
#include "server/records/catalog.h"
#include "server/records/replies.h"
#include "server/records/store.h"

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

// All that a catalogue has beside its file.
constexpr std::array companions = {"-wal", "-shm", ".lock", ".room"};

void remove_catalog(const fs::path& file) {
  fs::remove(file);
  for (const char* end : companions) fs::remove(file.native() + end);
}

void replace_catalog(const fs::path& data, std::vector<Finding>& findings) {
  const fs::path file = data / catalog_name, fresh = data / "catalog.salvaged";
  remove_catalog(fresh);  // of a repair that was interrupted
  const Salvage salvage = salvage_catalog(file, fresh);
  if (salvage.lost > 0) findings.push_back({Kind::lost_row, std::to_string(salvage.lost)});
  // A link, so that there is a catalogue at any time.
  const fs::path link = data / "catalog.aside";
  fs::remove(link);
  fs::create_hard_link(file, link);
  const fs::path aside = set_aside(data, link, catalog_name);
  // A write-ahead log would be taken for the new catalogue's.
  for (const char* end : {"-wal", "-shm"})
    if (fs::exists(file.native() + end)) move_durably(file.native() + end, aside.native() + end);
  move_durably(fresh, file);
  remove_catalog(fresh);
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

/// Of all that can be read; returns the ids of the others.
template <typename F>
std::vector<std::string> for_each_resource(const Catalog& catalog, const F& f) {
  std::vector<std::string> damaged;
  std::string cursor;
  do {
    const Page<Resource> page = catalog.list_all(cursor, 1000);
    std::ranges::for_each(page.items, f);
    damaged.insert(damaged.end(), page.damaged.begin(), page.damaged.end());
    cursor = page.next;
  } while (!cursor.empty());
  return damaged;
}

/// What is wrong with a resource's record, or its blobs.
std::optional<Kind> fault_of(const Resource& resource, const BlobStore& blobs) {
  try {
    check_record(resource);
  } catch (const Error& error) {
    if (error.code() == ErrorCode::corrupt) return Kind::damaged_record;
    throw;
  }
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

std::string text_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// One check, and what it mends.
class Check {
 public:
  Check(const fs::path& data, bool repair) : data_(data), repair_(repair) {}

  StoreReport run() {
    const std::unique_ptr<Catalog> catalog = open_catalog();
    if (!catalog) return std::move(report_);
    FileBlobStore blobs(data_ / blobs_name);
    bring_back(*catalog, blobs);
    const std::map<std::string, Kind> faulty = check_resources(*catalog, blobs);
    check_owners(*catalog, blobs);
    if (repair_) withdraw_faulty(*catalog, blobs, faulty);
    check_jobs(*catalog);
    check_small_files("uploads", ".info", [](const std::string& text) { return is_sound_upload(text); });
    check_small_files("replies", "", [](const std::string& text) { return reply_in(text).has_value(); });
    for_each_resource(*catalog, [&](const Resource& resource) {
      if (faulty.contains(resource.id)) return;
      ++report_.resources;
      report_.blobs += resource.blobs.size();
      report_.bytes += resource.bytes;
    });
    return std::move(report_);
  }

 private:
  void find(Kind kind, std::string what = {}) { report_.findings.push_back({kind, std::move(what)}); }

  /// Nothing when there is none that can be used, and none is to be made.
  std::unique_ptr<Catalog> open_catalog() {
    const fs::path file = data_ / catalog_name;
    if (!fs::exists(file)) {
      if (FileBlobStore::keys_in(data_ / blobs_name).empty()) throw_no_catalog();
      find(Kind::missing_catalogue);
      return repair_ ? std::make_unique<Catalog>(file) : nullptr;
    }
    std::unique_ptr<Catalog> catalog = open_sound(file, report_.findings);
    if (catalog || !repair_) return catalog;
    replace_catalog(data_, report_.findings);
    catalog = open_sound(file, report_.findings);
    if (!catalog) throw_no_catalog();
    return catalog;
  }

  /// What was moved to damaged/ while the catalogue was another one.
  void bring_back(const Catalog& catalog, const BlobStore& blobs) {
    if (!repair_ || !fs::exists(data_ / "damaged")) return;
    for_each_resource(catalog, [&](const Resource& resource) {
      for (const std::string& key : resource.blobs) {
        const fs::path file = data_ / blobs_name / key, aside = place_aside(data_, key);
        if (fs::exists(file) || !fs::exists(aside)) continue;
        move_durably(aside, file);
        try {
          blobs.open(key).verify();
          find(Kind::recovered_blob, resource.id);
        } catch (const Error& error) {
          if (error.code() != ErrorCode::corrupt) throw;
          move_durably(file, aside);
        }
      }
    });
  }

  std::map<std::string, Kind> check_resources(const Catalog& catalog, const BlobStore& blobs) {
    std::map<std::string, Kind> faulty;
    const std::vector<std::string> unreadable = for_each_resource(catalog, [&](const Resource& resource) {
      const std::optional<Kind> fault = fault_of(resource, blobs);
      if (!fault) return;
      find(*fault, resource.id);
      faulty.emplace(resource.id, *fault);
    });
    for (const std::string& id : unreadable) {
      find(Kind::damaged_record, id);
      faulty.emplace(id, Kind::damaged_record);
    }
    return faulty;
  }

  void check_owners(const Catalog& catalog, BlobStore& blobs) {
    for (const std::string& key : blobs.keys()) {
      if (catalog.owns_blob(key)) continue;
      find(Kind::unowned_blob, key);
      if (repair_) put_aside(blobs, key);
    }
  }

  void withdraw_faulty(Catalog& catalog, BlobStore& blobs, const std::map<std::string, Kind>& faulty) {
    for (const auto& [id, fault] : faulty) {
      try {
        if (const auto resource = catalog.find(id); resource && fault == Kind::damaged_record)
          set_text_aside(data_, resource->request + "\n" + resource->document + "\n", id + ".record");
      } catch (const Error& error) {
        if (error.code() != ErrorCode::corrupt) throw;  // else there is nothing to keep
      }
      try {
        for (const std::string& key : catalog.erase(id)) put_aside(blobs, key);
      } catch (const Error& error) {
        if (error.code() != ErrorCode::not_found) throw;  // else it went with what it was made from
      }
    }
  }

  void check_jobs(Catalog& catalog) {
    for (const std::string& id : catalog.damaged_jobs()) {
      find(Kind::damaged_job, id);
      if (repair_) catalog.forget_job(id);
    }
  }

  /// Files of which `sound` does not hold, with all that has their name.
  void check_small_files(const char* folder, std::string_view end,
                         const std::function<bool(const std::string&)>& sound) {
    std::vector<fs::path> damaged;
    std::error_code missing;
    for (const fs::directory_entry& entry : fs::directory_iterator(data_ / folder, missing)) {
      const fs::path& file = entry.path();
      // Drafts of what was never acknowledged go with the next start.
      if (file.extension() == end && !sound(text_of(file))) damaged.push_back(file);
    }
    for (const fs::path& file : damaged) {
      find(Kind::damaged_file, std::string(folder) + "/" + file.filename().native());
      if (!repair_) continue;
      for (const fs::path& part : {file, fs::path(file).replace_extension(end.empty() ? "" : ".part")})
        set_aside(data_, part, std::string(folder) + "/" + part.filename().native());
    }
  }

  void put_aside(BlobStore& blobs, const std::string& key) {
    set_aside(data_, data_ / blobs_name / key, key);
    blobs.settle(key);
  }

  const fs::path data_;
  const bool repair_;
  StoreReport report_;
};

}  // namespace

std::string_view to_string(Kind kind) {
  switch (kind) {
    case Kind::missing_catalogue: return "the catalogue is missing";
    case Kind::damaged_catalogue: return "the catalogue is damaged";
    case Kind::lost_row: return "rows of the catalogue that are lost";
    case Kind::damaged_record: return "a record is damaged";
    case Kind::damaged_job: return "a job's record is damaged";
    case Kind::damaged_file: return "a file is damaged";
    case Kind::missing_blob: return "a blob is missing";
    case Kind::damaged_blob: return "a blob is damaged";
    case Kind::recovered_blob: return "a blob was brought back from damaged/";
    case Kind::unowned_blob: break;
  }
  return "nothing owns this blob";
}

StoreReport check_store(const fs::path& data, bool repair) { return Check(data, repair).run(); }

StoreReport copy_store(const fs::path& from, const fs::path& to) {
  const fs::path file = to / catalog_name, partial = to / "catalog.partial";
  if (!fs::exists(from / catalog_name)) throw_no_catalog();
  if (fs::exists(file) || fs::exists(to / blobs_name))
    throw Error(ErrorCode::conflict, "The folder to copy to holds data already; name a new one.");
  make_folder(to);
  remove_catalog(partial);
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
  move_durably(partial, file);
  return check_store(to, true);
}

}  // namespace spherule::server
