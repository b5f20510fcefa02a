#!/bin/sh
# two_hosts.sh PROGRAM ARGS...: the program with one rank on each of two hosts, which are network namespaces joined by a
# cable; what the first sent and received goes to standard error. Exit code 77: this machine lets nobody make namespaces.
set -eu
if [ "$(id -u)" != 0 ]; then
  unshare -Urnm true 2>/dev/null || { echo "no user namespaces here: sysctl kernel.unprivileged_userns_clone" >&2; exit 77; }
  exec unshare -Urnm sh -c 'mount -t tmpfs none /run && exec "$0" "$@"' "$0" "$@"
fi
a=terse_a_$$ b=terse_b_$$
ip netns add $a 2>/dev/null || { echo "no network namespaces here: ip netns add is refused" >&2; exit 77; }
work=$(mktemp -d)
trap 'ip netns del $a; ip netns del $b 2>/dev/null; rm -rf "$work"' EXIT
ip netns add $b
ip -n $a link add cable type veth peer name cable netns $b
ip -n $a addr add 10.77.0.1/24 dev cable
ip -n $b addr add 10.77.0.2/24 dev cable
for host in $a $b; do
  ip -n $host link set lo up
  ip -n $host link set cable up
done
mkdir "$work/a" "$work/b"
# What mpirun takes for ssh: HOST COMMAND...
cat > "$work/agent" <<EOF
#!/bin/sh
shift
exec ip netns exec $b unshare --uts sh -c "hostname terse-b; export TMPDIR=$work/b; \$*"
EOF
chmod +x "$work/agent"
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
status=0
ip netns exec $a unshare --uts sh -c 'hostname terse-a; exec "$@"' sh env TMPDIR="$work/a" \
  mpirun --mca plm_rsh_agent "$work/agent" --host 10.77.0.1:1,10.77.0.2:1 -n 2 --mca mpi_yield_when_idle 1 \
  --mca oob_tcp_if_include 10.77.0.0/24 --mca btl_tcp_if_include 10.77.0.0/24 --mca btl tcp,self "$@" || status=$?
ip -n $a -s link show cable | awk '/RX:/ {getline; print "received", $1, "bytes"} /TX:/ {getline; print "sent", $1, "bytes"}' >&2
exit $status
