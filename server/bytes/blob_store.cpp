// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/bytes/blob_store.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <limits>
#include <set>
#include <system_error>
#include <utility>

#include "core/base/check.h"
#include "core/base/error.h"
#include "server/base/disk.h"

namespace spherule::server {

namespace fs = std::filesystem;

namespace {

// Between two looks at the free space; a few hundred writers at once stay within the reserve.
constexpr std::uint64_t look_every_bytes = std::uint64_t{256} << 10;

constexpr std::size_t digest_digits = 64;

bool is_name_part(std::string_view part) {
  return !part.empty() && std::all_of(part.begin(), part.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
  });
}

bool is_name(std::string_view name) {
  const std::size_t slash = name.find('/');
  return slash == std::string_view::npos ? is_name_part(name)
                                         : is_name_part(name.substr(0, slash)) && is_name_part(name.substr(slash + 1));
}

/// The random part lets a deletion never hit a later upload of the same bytes, whatever the order of events.
/// Key: <name>.<digest>.<random part>.
std::string make_key(std::string_view name, const std::string& digest) {
  return std::string(name) + "." + digest + "." + random_id("b");
}

/// The digest in a key; empty when `key` was not made by make_key.
std::string digest_of(std::string_view key) {
  const std::size_t dot = key.find('.');
  if (dot == std::string_view::npos || !is_name(key.substr(0, dot))) return {};
  const std::string_view rest = key.substr(dot + 1);
  if (rest.size() <= digest_digits || rest[digest_digits] != '.' || !is_id("b", rest.substr(digest_digits + 1)))
    return {};
  return std::string(rest.substr(0, digest_digits));
}

/// The file that says of a blob that it is on its way. Beside the blob, so that a power cut leaves both or neither: one
/// folder is one for the disk. Keys hold no plus.
fs::path note_of(const fs::path& root, const std::string& key) { return root / (key + "+"); }

/// Empty when that is no note.
std::string key_of_note(std::string name) {
  if (name.empty() || name.back() != '+') return {};
  name.pop_back();
  return digest_of(name).empty() ? std::string() : name;
}

void write_note(const fs::path& root, const std::string& key) {
  const File note(note_of(root, key), O_WRONLY | O_CREAT);
}

/// The key of which a note of earlier versions tells, whose notes were among the drafts.
std::string key_of_former_note(std::string name) {
  std::ranges::replace(name, '+', '/');
  return digest_of(name).empty() ? std::string() : name;
}

/// Relative paths of all that is under `root`.
std::vector<std::string> names_in(const fs::path& root) {
  std::vector<std::string> names;
  std::error_code missing;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(root, missing))
    names.push_back(entry.path().lexically_relative(root).generic_string());
  return names;
}

class FileStaging final : public Staging {
 public:
  FileStaging(std::uint64_t limit, fs::path root, const fs::path& temporary)
      : Staging(limit), root_(std::move(root)), path_(temporary / random_id("staging")) {
    file_.emplace(path_, O_WRONLY | O_APPEND | O_CREAT | O_EXCL);
  }

  ~FileStaging() override {
    if (!path_.empty()) ::unlink(path_.c_str());
  }

  void rest() override { file_.reset(); }

  Blob open() const override {
    SPHERULE_CHECK(!path_.empty());
    const int descriptor = ::open(path_.c_str(), O_RDONLY | O_CLOEXEC);
    if (descriptor < 0) throw_storage(errno);
    return {descriptor, path_, sha256()};
  }

  std::string commit(std::string_view name) override {
    SPHERULE_CHECK(!path_.empty() && is_name(name));
    // Only once the content is on the disk may the name be: a power cut in between must not leave an empty blob.
    writable().sync();
    rest();
    std::string key = make_key(name, sha256());
    const fs::path target = root_ / key;
    make_folder(target.parent_path());
    write_note(root_, key);
    if (::rename(path_.c_str(), target.c_str()) != 0) throw_storage(errno);
    path_ = target;  // until the folder is durable too, the destructor takes the blob back
    sync_to_disk(target.parent_path());
    path_.clear();
    return key;
  }

 protected:
  void write(std::string_view bytes) override {
    since_look_ += bytes.size();
    if (since_look_ >= look_every_bytes) {
      if (free_bytes_at(root_) < bytes.size()) throw_no_space();
      since_look_ = 0;
    }
    writable().write(bytes);
  }

 private:
  const File& writable() {
    if (!file_) file_.emplace(path_, O_WRONLY | O_APPEND);
    return *file_;
  }

  fs::path root_;
  fs::path path_;  // empty once committed
  std::optional<File> file_;
  std::uint64_t since_look_ = look_every_bytes;  // bytes; the first write looks
};

}  // namespace

std::string BlobStore::put(std::string_view name, std::string_view bytes) {
  const std::unique_ptr<Staging> staging = stage(std::numeric_limits<std::uint64_t>::max(), bytes.size());
  staging->append(bytes);
  return staging->commit(name);
}

FileBlobStore::FileBlobStore(fs::path root) : root_(std::move(root)) {
  make_folder(root_);
  make_folder(scratch_root());
  std::error_code ignored;  // the next start tries again
  for (const fs::directory_entry& entry : fs::directory_iterator(scratch_root(), ignored)) {
    const std::string key = key_of_former_note(entry.path().filename());
    if (!key.empty() && fs::exists(root_ / key, ignored))
      fs::rename(entry.path(), note_of(root_, key), ignored);
    else
      fs::remove_all(entry.path(), ignored);
  }
}

std::unique_ptr<Staging> FileBlobStore::stage(std::uint64_t limit, std::optional<std::uint64_t> declared) {
  if (declared && *declared > limit)
    throw Error(ErrorCode::too_large, "The data has " + std::to_string(*declared) + " bytes, and this server accepts " +
                                          std::to_string(limit) + "; send less, or raise its limit.");
  if (declared.value_or(0) > free_bytes()) throw_no_space();
  return std::make_unique<FileStaging>(limit, root_, scratch_root());
}

Blob FileBlobStore::open(const std::string& key) const {
  std::string digest = digest_of(key);
  const fs::path path = root_ / key;
  const int descriptor = digest.empty() ? -1 : ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) {
    if (!digest.empty() && errno != ENOENT) throw_storage(errno);
    throw Error(ErrorCode::not_found, "This data is no longer stored; it may have been deleted.");
  }
  return {descriptor, path, std::move(digest)};
}

void FileBlobStore::remove(const std::string& key) {
  if (digest_of(key).empty()) return;
  // Not made durable: with a blob that a power cut brings back comes its note, and the next start removes both.
  if (::unlink((root_ / key).c_str()) != 0 && errno != ENOENT) throw_storage(errno);
  settle(key);
}

std::vector<std::string> FileBlobStore::keys_in(const fs::path& root) {
  std::vector<std::string> keys = names_in(root);
  std::erase_if(keys, [](const std::string& name) { return digest_of(name).empty(); });
  return keys;
}

std::vector<std::string> FileBlobStore::unsettled() const {
  std::vector<std::string> keys;
  for (std::string& name : names_in(root_))
    if (std::string key = key_of_note(std::move(name)); !key.empty()) keys.push_back(std::move(key));
  return keys;
}

void FileBlobStore::settle(const std::string& key) {
  if (!digest_of(key).empty()) ::unlink(note_of(root_, key).c_str());
}

void FileBlobStore::unsettle(const std::vector<std::string>& keys) {
  std::set<fs::path> folders;
  for (const std::string& key : keys) try {
      if (digest_of(key).empty()) continue;
      write_note(root_, key);
      folders.insert(note_of(root_, key).parent_path());
    } catch (const Error&) {
      // Without it, the next start may set the blob aside.
    }
  for (const fs::path& folder : folders) try {
      sync_to_disk(folder);
    } catch (const Error&) {
    }
}

std::uint64_t FileBlobStore::free_bytes() const { return free_bytes_at(root_); }

// The dot keeps it apart from any name that a blob can have.
fs::path FileBlobStore::scratch_root() const { return root_ / ".tmp"; }

}  // namespace spherule::server
